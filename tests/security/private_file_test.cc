// Files with tokens survive a loss of power: the new ones or the old ones.
#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <stdlib.h>
#include <sys/stat.h>

#include <iotcloud/config/error.h>
#include <iotcloud/security/private_file.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/sync_calls.h>

namespace iotcloud::security {
namespace {

TEST(PrivateFile, IsReplacedOnTheDiskAndKeepsItsReaders) {
  std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-private-XXXXXX";
  const std::string folder = mkdtemp(pattern.data());
  const std::string file = folder + "/tokens";
  replace_private_file(file, "old");
  ASSERT_EQ(chmod(file.c_str(), 0640), 0);
  {
    const tests::SyncCalls synced;
    replace_private_file(file, "new");
    EXPECT_TRUE(synced.contains(folder)) << "its new name is not on the disk";
  }
  EXPECT_EQ(tests::read_file(file), "new");
  struct stat status {};
  ASSERT_EQ(stat(file.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0640u);
  {
    const tests::SyncCalls failing([&](const std::string& path) { return path == folder ? EIO : 0; });
    EXPECT_THROW(replace_private_file(file, "newer"), config::Error);
  }
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace iotcloud::security
