#include <string>

#include <gmock/gmock.h>

#include <iotcloud/drivers/plugin.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/probe_driver.h>

namespace iotcloud::gateway {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

std::string error_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const config::Error& e) {
    return e.what();
  }
  return "";
}

std::string load_error(const std::string& file) {
  return error_of([&] { Plugin::load(std::string(TEST_PLUGINS) + "/" + file); });
}

TEST(Plugin, AGoodPluginGivesItsDescriptor) {
  const auto plugin = Plugin::load(std::string(TEST_PLUGINS) + "/probe.so");
  EXPECT_EQ(plugin->name(), "probe");
  EXPECT_FALSE(plugin->descriptor().own_thread);
}

TEST(Plugin, OneOfAnotherSdkIsRefusedNamingBothSides) {
  EXPECT_THAT(load_error("future_sdk.so"),
              AllOf(HasSubstr("future_sdk.so"), HasSubstr("4711"),
                    HasSubstr("this driver host has version " + std::to_string(drivers::sdk_version))));
}

TEST(Plugin, OneOfAnotherAbiIsRefusedNamingBothSides) {
  auto descriptor = drivers::describe<ProbeDriver>("probe", "1");
  descriptor.cxx_abi = "itanium;libc++";
  EXPECT_THAT(error_of([&] { Plugin::wrap(descriptor, "probe.so"); }),
              AllOf(HasSubstr("\"itanium;libc++\""), HasSubstr(IOTCLOUD_CXX_ABI)));
}

TEST(Plugin, ADescriptorOfAnotherSizeIsRefused) {
  auto descriptor = drivers::describe<ProbeDriver>("probe", "1");
  descriptor.size += 8;
  EXPECT_THAT(error_of([&] { Plugin::wrap(descriptor, "probe.so"); }), HasSubstr("rebuild the driver"));
}

TEST(Plugin, ALibraryThatIsNoDriverIsRefused) {
  EXPECT_THAT(load_error("no_driver.so"), HasSubstr("IOTCLOUD_DRIVER"));
}

TEST(Plugin, ASymbolThatNothingDefinesIsNamedAsInTheSourceWithTheFileAndBothSdks) {
  const std::string file = std::string(TEST_PLUGINS) + "/dangling.so";
  const auto bytes = tests::read_file(file);
  const std::string error = error_of([&] { Plugin::load_exactly(file, security::sha256_hex(bytes), "station.so"); });
  EXPECT_THAT(error,
              AllOf(HasSubstr("station.so (" + file + ")"), HasSubstr("nothing defines weather::calibrated(double);"),
                    HasSubstr("built with driver SDK version " + std::to_string(drivers::sdk_version)),
                    Not(HasSubstr("/proc/self/fd"))));
}

TEST(Plugin, AFileThatIsNotThereIsNamed) {
  EXPECT_THAT(load_error("absent.so"), HasSubstr("absent.so"));
}

TEST(Plugin, OnlyAPlainFileNameNamesAPlugin) {
  EXPECT_NO_THROW(check_plugin_file_name("turtle.so"));
  EXPECT_NO_THROW(check_plugin_file_name("..turtle.so"));
  for (const std::string name : {"", ".", "..", "/etc/x.so", "../x.so", "a/b.so", "a\n.so"}) {
    EXPECT_NE(error_of([&] { check_plugin_file_name(name); }), "") << name;
  }
}

}  // namespace
}  // namespace iotcloud::gateway
