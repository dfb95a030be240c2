#include <chrono>
#include <cstring>

#include <dlfcn.h>
#include <gmock/gmock.h>

#include <iotcloud/config/declaration.h>
#include <iotcloud/drivers/testing/mock_host.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/files.h>

namespace iotcloud::drivers {
namespace {

using namespace std::chrono_literals;

struct Shipped {
  const char* file;
  const char* name;
  const char* channel;  ///< the channel on which it publishes unasked
  bool own_thread;
};

class ShippedPlugin : public ::testing::TestWithParam<Shipped> {};

TEST_P(ShippedPlugin, is_found_by_its_one_symbol_and_runs_in_a_host) {
  void* library = dlopen(GetParam().file, RTLD_NOW | RTLD_LOCAL);
  ASSERT_NE(library, nullptr) << dlerror();
  using Entry = const Descriptor* (*)();
  const auto entry = reinterpret_cast<Entry>(dlsym(library, descriptor_symbol));
  ASSERT_NE(entry, nullptr);
  const Descriptor& descriptor = *entry();
  EXPECT_EQ(descriptor.sdk_version, sdk_version);
  EXPECT_EQ(descriptor.size, sizeof(Descriptor));
  EXPECT_STREQ(descriptor.cxx_abi, IOTCLOUD_CXX_ABI);
  EXPECT_STREQ(descriptor.name, GetParam().name);
  EXPECT_EQ(descriptor.own_thread, GetParam().own_thread);
  {
    testing::MockInstance instance(descriptor);
    ASSERT_TRUE(instance.start()) << instance.error();
    // loadgen uses the real clock: simulated ticks until it has sent a message.
    const auto deadline = std::chrono::steady_clock::now() + tests::patience;
    while (instance.host().published(GetParam().channel).empty() && std::chrono::steady_clock::now() < deadline) {
      instance.host().advance(100ms);
    }
    EXPECT_FALSE(instance.host().published(GetParam().channel).empty());
    instance.close();
    EXPECT_EQ(instance.error(), "");
  }
  EXPECT_EQ(dlclose(library), 0);
}

TEST_P(ShippedPlugin, declares_in_its_bytes_what_its_descriptor_says) {
  const auto read = config::declaration_in(tests::read_file(GetParam().file));
  EXPECT_EQ(read.driver, GetParam().name);
  EXPECT_EQ(read.version, "1.0");
  EXPECT_EQ(read.sdk_version, sdk_version);
  EXPECT_NE(read.description, "");
  void* library = dlopen(GetParam().file, RTLD_NOW | RTLD_LOCAL);
  ASSERT_NE(library, nullptr) << dlerror();
  using Entry = const Descriptor* (*)();
  const auto told = config::declaration_of(reinterpret_cast<Entry>(dlsym(library, descriptor_symbol))()->declaration);
  ASSERT_TRUE(read.properties);
  EXPECT_EQ(read.properties, told.properties);
  EXPECT_EQ(dlclose(library), 0);
}

INSTANTIATE_TEST_SUITE_P(All, ShippedPlugin,
                         ::testing::Values(Shipped{TURTLE_PLUGIN, "turtle", "kinect", true},
                                           Shipped{LOADGEN_PLUGIN, "loadgen", "data", false}),
                         [](const auto& shipped) { return std::string(shipped.param.name); });

}  // namespace
}  // namespace iotcloud::drivers
