// What is in corpus/, for all programs of fuzz targets.
#include <cstdint>
#include <filesystem>
#include <set>
#include <sstream>
#include <string>

#include <gtest/gtest.h>

namespace {

/// The targets that CMakeLists.txt names.
std::set<std::string> names_of_all_targets() {
  std::istringstream words(IOTCLOUD_FUZZ_NAMES);
  std::set<std::string> names;
  for (std::string word; words >> word;) names.insert(word);
  return names;
}

TEST(HostileInputs, AreOfTargetsThatThereAreAndSmall) {
  const std::set<std::string> known = names_of_all_targets();
  std::uintmax_t size = 0;
  const auto corpus = std::filesystem::path(IOTCLOUD_TEST_SERVERS).parent_path() / "fuzz/corpus";
  for (const auto& file : std::filesystem::recursive_directory_iterator(corpus)) {
    if (file.is_directory()) {
      EXPECT_TRUE(known.contains(file.path().filename())) << file.path();
    } else {
      size += file.file_size();
    }
  }
  EXPECT_LT(size, 200'000U);
}

}  // namespace
