#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <stdlib.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/log_reader.h>

namespace iotcloud::processes {
namespace {

namespace fs = std::filesystem;

class LogReaderTest : public ::testing::Test {
 protected:
  LogReaderTest() {
    std::string pattern = fs::temp_directory_path() / "iotcloud-log-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    path_ = folder_ / "p.log";
  }
  ~LogReaderTest() override { fs::remove_all(folder_); }
  void write(const std::string& text) const { std::ofstream(path_, std::ios::app) << text; }
  void move_away() const {
    for (int number = 5; number > 0; --number) {
      const std::string from = number == 1 ? path_ : path_ + "." + std::to_string(number - 1);
      if (fs::exists(from)) fs::rename(from, path_ + "." + std::to_string(number));
    }
  }
  /// Reads on to the end.
  std::string rest(std::string& position, std::size_t most = 100) const {
    std::string text;
    for (;;) {
      const auto part = read_log(path_, position, most);
      position = part.position;
      if (part.text.empty()) return text;
      text += part.text;
    }
  }

  fs::path folder_;
  std::string path_;
};

TEST_F(LogReaderTest, BeginsAtTheEndWithAWholeLine) {
  write("one\ntwo\nthree\n");
  EXPECT_EQ(read_log(path_, "", 1000).text, "one\ntwo\nthree\n");
  EXPECT_EQ(read_log(path_, "", 8).text, "three\n");
}

TEST_F(LogReaderTest, GoesOnWithWhatIsNewAndLeavesALineThatIsBeingWritten) {
  write("one\n");
  auto position = read_log(path_, "", 100).position;
  EXPECT_EQ(rest(position), "");
  write("two\nthr");
  EXPECT_EQ(rest(position), "two\n");
  write("ee\n");
  EXPECT_EQ(rest(position), "three\n");
}

TEST_F(LogReaderTest, MissesNothingWhenTheLogIsMovedAway) {
  write("one\n");
  auto position = read_log(path_, "", 100).position;
  write("two\n");
  move_away();
  write("three\n");
  move_away();
  write("four\n");
  EXPECT_EQ(rest(position, 6), "two\nthree\nfour\n");
}

TEST_F(LogReaderTest, GoesOnWithTheOldestThatIsKept) {
  write("one\n");
  auto position = read_log(path_, "", 100).position;
  move_away();
  write("two\n");
  move_away();
  write("three\n");
  fs::remove(path_ + ".2");
  EXPECT_EQ(rest(position), "two\nthree\n");
}

TEST_F(LogReaderTest, ALogThatIsNotThereAndAPositionThatIsNoneAreErrors) {
  EXPECT_THROW(read_log(path_, "", 10), config::Error);
  write("one\n");
  for (const auto* position : {"x", "1", "1:", ":1", "1:2x", "-1:0"}) {
    EXPECT_THROW(read_log(path_, position, 10), config::Error) << position;
  }
}

TEST_F(LogReaderTest, ShowsNoFileToWhichALinkInTheLogsPlaceLeads) {
  std::ofstream(folder_ / "secret") << "s";
  fs::create_symlink(folder_ / "secret", path_);
  std::string position;
  EXPECT_THROW(read_log(path_, position, 100), config::Error);
}

}  // namespace
}  // namespace iotcloud::processes
