// The folder in which a daemon keeps what outlives it: closed to others, and on the disk.
#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <stdlib.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/state_folder.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/sync_calls.h>

namespace iotcloud::processes {
namespace {

class StateFolderTest : public ::testing::Test {
 protected:
  StateFolderTest() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-state-XXXXXX";
    parent_ = mkdtemp(pattern.data());
    folder_ = parent_ + "/state";
  }
  ~StateFolderTest() override { std::filesystem::remove_all(parent_); }

  static mode_t mode(const std::string& path) {
    struct stat status {};
    EXPECT_EQ(stat(path.c_str(), &status), 0) << path;
    return status.st_mode & 0777;
  }
  std::string parent_, folder_;
};

TEST_F(StateFolderTest, ItsIdIsOnTheDiskAndTheSameInEveryRun) {
  std::string id;
  {
    const tests::SyncCalls synced;
    id = StateFolder(folder_).id();
    EXPECT_TRUE(synced.contains(folder_));
  }
  EXPECT_FALSE(id.empty());
  EXPECT_EQ(mode(folder_), 0700u);
  EXPECT_EQ(mode(folder_ + "/id"), 0600u);
  EXPECT_EQ(StateFolder(folder_).id(), id);
}

TEST_F(StateFolderTest, AnIdThatCannotBeBroughtToTheDiskIsAnError) {
  const tests::SyncCalls failing([&](const std::string& path) { return path.starts_with(folder_) ? EIO : 0; });
  EXPECT_THROW(StateFolder{folder_}, config::Error);
}

TEST_F(StateFolderTest, OneThatIsOpenToOthersIsClosedAndTheLogSaysSo) {
  { StateFolder made(folder_); }
  std::ofstream(folder_ + "/history.jsonl") << "{}";
  ASSERT_EQ(chmod(folder_.c_str(), 0755), 0);
  ASSERT_EQ(chmod((folder_ + "/id").c_str(), 0644), 0);
  ASSERT_EQ(chmod((folder_ + "/history.jsonl").c_str(), 0666), 0);
  const tests::CapturedLog log;
  { StateFolder closed(folder_); }
  EXPECT_EQ(mode(folder_), 0700u);
  EXPECT_EQ(mode(folder_ + "/id"), 0600u);
  EXPECT_EQ(mode(folder_ + "/history.jsonl"), 0600u);
  EXPECT_TRUE(log.contains(folder_ + " was open to others"));
}

TEST_F(StateFolderTest, OneThroughWhichItsGroupMayPassStaysSo) {
  { StateFolder made(folder_); }
  ASSERT_EQ(chmod(folder_.c_str(), 0710), 0);  // for driver hosts under an account of their own
  const tests::CapturedLog log;
  { StateFolder again(folder_); }
  EXPECT_EQ(mode(folder_), 0710u);
  EXPECT_EQ(log.text(), "");
}

}  // namespace
}  // namespace iotcloud::processes
