#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/processes/log_file.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::processes {
namespace {

using ::testing::ElementsAre;
using ::testing::Le;
namespace fs = std::filesystem;

class LogFileTest : public ::testing::Test {
 protected:
  LogFile::Options options(std::uint64_t most_bytes, int kept) const { return {folder_ / "p.log", most_bytes, kept}; }

  /// A process whose stdout goes to the log, and which writes so many lines that begin with `name`.
  pid_t write_lines(const std::string& name, int count, const LogFile::Options& options) const {
    const pid_t child = fork();
    if (child != 0) return child;
    const int out = open(options.path.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
    dup2(out, STDOUT_FILENO);
    dup2(out, STDERR_FILENO);
    close(out);
    const LogFile log(options);
    for (int i = 0; i < count; ++i) {
      const std::string line = name + " " + std::to_string(i) + "\n";
      if (write(i % 2 == 0 ? STDOUT_FILENO : STDERR_FILENO, line.data(), line.size()) < 0) _exit(1);
      log.rotate_if_too_long();
    }
    _exit(0);
  }
  static void wait_for(pid_t child) {
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_EQ(status, 0);
  }
  /// The numbers of one writer's lines, in the order of the files, the oldest first.
  std::vector<int> numbers(const std::string& name, int files) const {
    std::vector<int> all;
    for (int number = files; number >= 0; --number) {
      std::ifstream in(folder_ / (number == 0 ? "p.log" : "p.log." + std::to_string(number)));
      std::string word;
      for (int i = 0; in >> word >> i;) {
        if (word == name) all.push_back(i);
      }
    }
    return all;
  }

  const tests::TemporaryFolder folder_;
};

TEST_F(LogFileTest, StaysWithinItsBoundsAndTheLatestIsKept) {
  wait_for(write_lines("a", 1000, options(500, 2)));
  std::vector<std::string> names;
  for (const auto& file : fs::directory_iterator(folder_.path())) {
    names.push_back(file.path().filename());
    EXPECT_THAT(file.file_size(), Le(520u)) << file.path();
  }
  std::sort(names.begin(), names.end());
  EXPECT_THAT(names, ElementsAre("p.log", "p.log.1", "p.log.2"));
  const auto kept = numbers("a", 2);
  ASSERT_GT(kept.size(), 100u);
  EXPECT_EQ(kept.back(), 999);
  for (std::size_t i = 1; i < kept.size(); ++i) ASSERT_EQ(kept[i], kept[i - 1] + 1) << "a line is missing";
}

TEST_F(LogFileTest, ProcessesThatShareItLoseNothing) {
  constexpr int many = 400;
  const auto shared = options(2000, many);
  const pid_t a = write_lines("a", many, shared), b = write_lines("b", many, shared);
  wait_for(a);
  wait_for(b);
  for (const std::string name : {"a", "b"}) {
    auto all = numbers(name, many);
    std::sort(all.begin(), all.end());  // one of them may have followed a moment later
    ASSERT_EQ(all.size(), static_cast<std::size_t>(many)) << name;
    for (int i = 0; i < many; ++i) ASSERT_EQ(all[static_cast<std::size_t>(i)], i);
  }
}

TEST_F(LogFileTest, WithoutOlderOnesTheFileBeginsAnew) {
  wait_for(write_lines("a", 200, options(500, 0)));
  EXPECT_FALSE(fs::exists(folder_ / "p.log.1"));
  EXPECT_THAT(fs::file_size(folder_ / "p.log"), Le(520u));
}

}  // namespace
}  // namespace iotcloud::processes
