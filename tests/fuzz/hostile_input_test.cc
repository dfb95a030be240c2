// Runs the fuzz targets without libFuzzer: each gets the files of its folder in corpus/, and then mutations of them
// that are the same in each run.
//
// A target that dies or hangs reports the input: the number of a file or, after the files, of a mutation. To give a
// target only that input, and to find its bytes in the file TARGET-NUMBER:
//   IOTCLOUD_HOSTILE_INPUT=NUMBER hostile_input_test --gtest_filter=*/TARGET
// (or hostile_peers_test, which has the targets with threads).
// A target whose server outlives an input may also need the earlier inputs; then only the whole run reproduces it.
#include <algorithm>
#include <array>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <gtest/gtest.h>
#include <unistd.h>

#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/tests/fuzz/mutations.h"
#include <iotcloud/tests/files.h>

// Sanitizer errors end in SIGABRT, like everything else that ends a target. The sanitizers look these functions up by
// name.
// NOLINTBEGIN(bugprone-reserved-identifier)
extern "C" __attribute__((visibility("default"))) const char* __asan_default_options() {
  return "abort_on_error=1";
}
extern "C" __attribute__((visibility("default"))) const char* __ubsan_default_options() {
  return "abort_on_error=1";
}
extern "C" __attribute__((visibility("default"))) const char* __tsan_default_options() {
  return "abort_on_error=1";
}
// NOLINTEND(bugprone-reserved-identifier)

namespace {

using namespace iotcloud;

constexpr unsigned most_seconds = 60;  // for one input, which takes a few milliseconds

/// The target's present input, as text, because a signal handler may only write it.
std::array<char, 256> current{};
std::size_t current_size = 0;

void say_current() {
  [[maybe_unused]] const ssize_t written = write(STDERR_FILENO, current.data(), current_size);
}

void set_current(const std::string& target, std::size_t number) {
  const int size = std::snprintf(current.data(), current.size(),
                                 "\nThis was the input %zu of %s. To give it that one alone:\n"
                                 "  IOTCLOUD_HOSTILE_INPUT=%zu " IOTCLOUD_FUZZ_PROGRAM " --gtest_filter=*/%s\n",
                                 number, target.c_str(), number, target.c_str());
  current_size = std::min(current.size(), static_cast<std::size_t>(size));
}

void on_abort(int) {
  say_current();
}

void on_alarm(int) {
  constexpr std::string_view text = "\nThe target does not come to an end.";
  [[maybe_unused]] const ssize_t written = write(STDERR_FILENO, text.data(), text.size());
  std::abort();
}

std::optional<std::size_t> only_input() {
  const char* const number = std::getenv("IOTCLOUD_HOSTILE_INPUT");
  if (number == nullptr) return std::nullopt;
  return std::stoul(number);
}

std::vector<std::string> names_of_targets() {
  std::vector<std::string> names;
  for (const auto& [name, target] : fuzz::targets()) names.push_back(name);
  return names;
}

const std::filesystem::path corpus = std::filesystem::path(IOTCLOUD_TEST_SERVERS).parent_path() / "fuzz/corpus";

/// The files of a target, in the order of their names.
std::vector<std::string> seeds_of(const std::string& target) {
  std::vector<std::filesystem::path> files;
  if (!std::filesystem::exists(corpus / target)) return {};
  for (const auto& file : std::filesystem::directory_iterator(corpus / target)) files.push_back(file.path());
  std::sort(files.begin(), files.end());
  std::vector<std::string> seeds;
  seeds.reserve(files.size());
  for (const auto& file : files) seeds.push_back(tests::read_file(file));
  return seeds;
}

class HostileInput : public testing::TestWithParam<std::string> {
 protected:
  void SetUp() override {
    std::signal(SIGABRT, on_abort);
    std::signal(SIGALRM, on_alarm);
  }
  void TearDown() override {
    alarm(0);
    if (HasFailure()) say_current();  // an exception
    current_size = 0;
    std::signal(SIGABRT, SIG_DFL);
    std::signal(SIGALRM, SIG_DFL);
  }

  /// Copies the input to memory of exact size, so that asan sees reads beyond its end.
  static void give(const fuzz::Target& target, const std::string& input) {
    const auto bytes = std::make_unique<std::uint8_t[]>(input.size());
    std::copy(input.begin(), input.end(), bytes.get());
    alarm(most_seconds);
    target.run(bytes.get(), input.size());
  }
};

TEST_P(HostileInput, DoesNoHarm) {
  const fuzz::Target& target = fuzz::targets().at(GetParam());
  const std::vector<std::string> seeds = seeds_of(GetParam());
  ASSERT_FALSE(seeds.empty()) << "there is no file in " << corpus / GetParam()
                              << "; add inputs to seeds.h's functions, and `./dev fuzz --seeds` writes them";
  const auto input = [&](std::size_t number) {
    return number < seeds.size() ? seeds[number] : fuzz::mutation(seeds, number);
  };
  const std::optional<std::size_t> only = only_input();
  if (only) {
    std::ofstream(GetParam() + "-" + std::to_string(*only), std::ios::binary) << input(*only);
    set_current(GetParam(), *only);
    give(target, input(*only));
    return;
  }
  for (std::size_t number = 0; number < seeds.size() + target.mutations; ++number) {
    set_current(GetParam(), number);
    give(target, input(number));
  }
}

INSTANTIATE_TEST_SUITE_P(Of, HostileInput, testing::ValuesIn(names_of_targets()),
                         [](const auto& target) { return target.param; });

}  // namespace
