#include <chrono>
#include <cstring>
#include <string>
#include <vector>

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
  const char* name;
  const char* channel;  ///< the channel on which it publishes unasked; empty: none
  bool own_thread;
  PropertyMap properties{};  ///< those that it needs
  std::string file() const { return std::string(PLUGINS) + name + ".so"; }
};

class ShippedPlugin : public ::testing::TestWithParam<Shipped> {};

TEST_P(ShippedPlugin, is_found_by_its_one_symbol_and_runs_in_a_host) {
  void* library = dlopen(GetParam().file().c_str(), RTLD_NOW | RTLD_LOCAL);
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
    testing::MockInstance instance(descriptor, GetParam().properties);
    ASSERT_TRUE(instance.start()) << instance.error();
    // loadgen uses the real clock: simulated ticks until it has sent a message.
    const auto deadline = std::chrono::steady_clock::now() + tests::patience;
    const std::string channel = GetParam().channel;
    while (!channel.empty() && instance.host().published(channel).empty() &&
           std::chrono::steady_clock::now() < deadline) {
      instance.host().advance(100ms);
    }
    EXPECT_EQ(instance.host().published(channel).empty(), channel.empty());
    instance.close();
    EXPECT_EQ(instance.error(), "");
  }
  EXPECT_EQ(dlclose(library), 0);
}

TEST_P(ShippedPlugin, declares_in_its_bytes_what_its_descriptor_says) {
  const auto read = config::declaration_in(tests::read_file(GetParam().file()));
  EXPECT_EQ(read.driver, GetParam().name);
  EXPECT_EQ(read.version, "1.0");
  EXPECT_EQ(read.sdk_version, sdk_version);
  EXPECT_NE(read.description, "");
  void* library = dlopen(GetParam().file().c_str(), RTLD_NOW | RTLD_LOCAL);
  ASSERT_NE(library, nullptr) << dlerror();
  using Entry = const Descriptor* (*)();
  const auto told = config::declaration_of(reinterpret_cast<Entry>(dlsym(library, descriptor_symbol))()->declaration);
  ASSERT_TRUE(read.properties);
  EXPECT_EQ(read.properties, told.properties);
  EXPECT_EQ(dlclose(library), 0);
}

std::vector<Shipped> all_shipped() {
  std::vector<Shipped> all{Shipped{"turtle", "kinect", true},
                           Shipped{"loadgen", "data", false},
                           Shipped{"serial", "", false, {{"device", "/dev/null"}}},
                           Shipped{"tcp", "", false, {{"listen", "127.0.0.1:0"}}},
                           Shipped{"udp", "", false, {{"listen", "127.0.0.1:0"}}},
                           Shipped{"exec", "", true, {{"command", "cat"}}},
                           Shipped{"can", "", false, {{"interface", "no-such-can"}}}};
#ifdef HAS_HTTP
  all.push_back({"http", "", false, {{"listen", "127.0.0.1:0"}}});
#endif
#ifdef HAS_MQTT
  all.push_back({"mqtt", "", true, {{"url", "mqtt://127.0.0.1:1"}}});
#endif
#ifdef HAS_CAMERA
  all.push_back({"camera", "", true, {{"source", "v4l2:/dev/no-such-camera"}}});
#endif
#ifdef HAS_ROS
  all.push_back({"ros", "", true, {{"subscribe", "/topic"}, {"ros_master", "http://127.0.0.1:1"}}});
#endif
#ifdef HAS_MQTT_FINDER
  all.push_back({"mqtt_finder", "", true, {{"url", "mqtt://127.0.0.1:1"}, {"find", "homeassistant"}}});
#endif
#ifdef HAS_SPARKPLUG
  all.push_back({"sparkplug", "", true, {{"url", "mqtt://127.0.0.1:1"}, {"group", "a"}, {"node", "b"}}});
#endif
#ifdef HAS_USB_FINDER
  all.push_back({"usb_finder", "", false});
#endif
#ifdef HAS_MDNS_FINDER
  all.push_back({"mdns_finder", "", false, {{"services", "_http._tcp"}, {"to", "127.0.0.1:9"}}});
#endif
#ifdef HAS_ONVIF_FINDER
  all.push_back({"onvif_finder", "", false, {{"to", "127.0.0.1:9"}}});
#endif
#ifdef HAS_MODBUS
  all.push_back({"modbus", "", true, {{"connect", "127.0.0.1:1"}, {"registers", "[{name: a, address: 1}]"}}});
#endif
  return all;
}

INSTANTIATE_TEST_SUITE_P(All, ShippedPlugin, ::testing::ValuesIn(all_shipped()),
                         [](const auto& shipped) { return std::string(shipped.param.name); });

}  // namespace
}  // namespace iotcloud::drivers
