// plugin check: what a plugin is, or why it cannot be loaded.
#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/tests/files.h>
#include <iotcloud/tests/master/process.h>
#include <iotcloud/tests/security/certificates.h>

namespace iotcloud::master::test {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

Finished check(const std::string& file, const std::vector<std::string>& more = {}) {
  std::vector<std::string> words{IOTCLOUD_CLI, "plugin", "check", file};
  words.insert(words.end(), more.begin(), more.end());
  return run_program(words);
}

TEST(CliPluginCheck, SaysWhatADriverPluginIs) {
  const auto done = check(LOADGEN_PLUGIN);
  EXPECT_EQ(done.status, 0) << done.err;
  EXPECT_THAT(done.out, AllOf(HasSubstr("loadgen.so: a driver plugin that can be loaded"), HasSubstr("loadgen\n"),
                              HasSubstr("sdk_version"), HasSubstr("a number from 0.01 to")));
}

TEST(CliPluginCheck, SaysWhatAComponentLibraryRegisters) {
  const auto done = check(GOOD_LIBRARY, {"--output", "json"});
  EXPECT_EQ(done.status, 0) << done.err;
  const auto data = nlohmann::json::parse(done.out);
  EXPECT_EQ(data["kind"], "component library");
  EXPECT_EQ(data["bolts"], nlohmann::json({"good.Echo"}));
}

TEST(CliPluginCheck, NamesWhatIsMissingBeforeAnythingIsDeployed) {
  const auto done = check(DANGLING_PLUGIN);
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, AllOf(StartsWith("iotcloud: the driver plugin "),
                              HasSubstr("dangling.so cannot be loaded: nothing "
                                        "defines weather::calibrated(double)"),
                              HasSubstr("it was built with driver SDK version ")));
}

TEST(CliPluginCheck, RefusesWhatIsNoPlugin) {
  const tests::TemporaryFolder folder;
  const std::string file = tests::write_file(folder / "notes.so", "no library at all");
  EXPECT_THAT(check(file).err, HasSubstr("is no plugin: it exports neither iotcloud_driver_descriptor"));
  const std::string torn = tests::write_file(folder / "torn.so", "iotcloud_driver_descriptor");
  const auto done = check(torn);
  EXPECT_EQ(done.status, 1);
  EXPECT_THAT(done.err, AllOf(HasSubstr("torn.so cannot be loaded: "), Not(HasSubstr("/proc/self"))));
  EXPECT_EQ(check(folder / "absent.so").status, 2);
}

}  // namespace
}  // namespace iotcloud::master::test
