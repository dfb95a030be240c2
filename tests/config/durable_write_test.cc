// Files that are complete or not there, also when the disk fails.
#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/sync_calls.h>

namespace iotcloud::config {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;
using tests::read_file;

class DurableWrite : public ::testing::Test {
 protected:
  DurableWrite() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-durable-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    file_ = folder_ + "/file";
  }
  ~DurableWrite() override { std::filesystem::remove_all(folder_); }

  std::size_t entries() const {
    const std::filesystem::directory_iterator all(folder_);
    return static_cast<std::size_t>(std::distance(begin(all), end(all)));
  }

  std::string folder_, file_;
};

TEST_F(DurableWrite, AReplacedFileIsOnTheDiskBeforeItsNameIs) {
  replace_file(file_, "old", 0600);
  const tests::SyncCalls synced;
  replace_file(file_, "new", 0640);
  EXPECT_THAT(synced.paths(), ElementsAre(StartsWith(file_ + ".new"), folder_));
  EXPECT_EQ(read_file(file_), "new");
  struct stat status {};
  ASSERT_EQ(stat(file_.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0640u);
  EXPECT_EQ(entries(), 1u);
}

TEST_F(DurableWrite, WhenTheNewTextCannotBeBroughtToTheDiskTheOldOneStays) {
  replace_file(file_, "old", 0600);
  const tests::SyncCalls synced([this](const std::string& path) { return path.starts_with(file_) ? EIO : 0; });
  EXPECT_THROW(replace_file(file_, "new", 0600), Error);
  EXPECT_EQ(read_file(file_), "old");
  EXPECT_EQ(entries(), 1u);
}

TEST_F(DurableWrite, WhenTheNameCannotBeBroughtToTheDiskThatIsAnError) {
  const tests::SyncCalls synced([this](const std::string& path) { return path == folder_ ? EIO : 0; });
  EXPECT_THROW(replace_file(file_, "new", 0600), Error);
  std::filesystem::remove(file_);
  EXPECT_THROW(write_new_file(file_, "text", 0600), Error);
  EXPECT_EQ(entries(), 0u);
}

TEST_F(DurableWrite, WhatAKilledProcessLeftIsRemovedAndWhatALivingOneWritesStays) {
  const std::string gone = ".new-2147483647";  // more than the largest id of a process
  const std::string living = ".new-" + std::to_string(getppid());
  for (const auto& name : {gone, living, std::string(".new-"), gone + "x", "2" + gone}) {
    tests::write_file(file_ + name, "new");
  }
  replace_file(file_, "text", 0600);
  EXPECT_FALSE(std::filesystem::exists(file_ + gone));
  for (const auto& name : {living, std::string(".new-"), gone + "x", "2" + gone}) {
    EXPECT_TRUE(std::filesystem::exists(file_ + name)) << name;
  }
  EXPECT_EQ(read_file(file_), "text");
}

TEST_F(DurableWrite, ANewFileReplacesNothing) {
  const tests::SyncCalls synced;
  write_new_file(file_, "first", 0600);
  EXPECT_THAT(synced.paths(), ElementsAre(file_, folder_));
  try {
    write_new_file(file_, "second", 0600);
    FAIL() << "it is there";
  } catch (const Error& e) {
    EXPECT_THAT(e.what(), HasSubstr(file_));
  }
  EXPECT_EQ(read_file(file_), "first");
}

}  // namespace
}  // namespace iotcloud::config
