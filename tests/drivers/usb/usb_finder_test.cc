// The finder of USB devices on a system that umockdev plays: its udev, its /sys and its /dev.
#include <cstdlib>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <umockdev.h>
#include <unistd.h>

#include <iotcloud/drivers/usb/usb_finder.h>
#include <iotcloud/tests/drivers/stream/until.h>

namespace iotcloud::drivers::usb {
namespace {

using ::testing::HasSubstr;
using ::testing::IsSupersetOf;
using testing::MockInstance;
using ::testing::SizeIs;

/// A system without devices, for this process.
class PlayedSystem {
 public:
  PlayedSystem() : bed_(umockdev_testbed_new()) {}
  ~PlayedSystem() { g_object_unref(bed_); }
  PlayedSystem(const PlayedSystem&) = delete;
  PlayedSystem& operator=(const PlayedSystem&) = delete;

  /// Plugs in an adapter with a serial line. \return the path of the line in /sys
  std::string plug_in(const std::string& serial, const std::string& line) {
    const std::string port = "usb-" + serial;
    std::string whole =
        add("usb", port, nullptr,
            {"idVendor", "0403", "idProduct", "6001", "serial", serial, "manufacturer", "FTDI", "product", "FT232R"},
            {"DEVTYPE", "usb_device", "DEVNAME", "/dev/bus/usb/001/" + serial});
    std::string interface =
        add("usb", port + ":1.0", whole.c_str(), {"bInterfaceNumber", "00"}, {"DEVTYPE", "usb_interface"});
    return add("tty", line, interface.c_str(), {},
               {"DEVNAME", "/dev/" + line, "DEVLINKS", "/dev/serial/by-id/usb-FTDI_" + serial + "-if00"});
  }
  std::string add(const char* subsystem, const std::string& name, const char* parent,
                  std::vector<std::string> attributes, std::vector<std::string> properties) {
    auto words = [](std::vector<std::string>& texts) {
      std::vector<gchar*> pointers;
      for (auto& text : texts) pointers.push_back(text.data());
      pointers.push_back(nullptr);
      return pointers;
    };
    auto attribute_words = words(attributes), property_words = words(properties);
    gchar* path = umockdev_testbed_add_devicev(bed_, subsystem, name.c_str(), parent, attribute_words.data(),
                                               property_words.data());
    std::string made = path;
    g_free(path);
    return made;
  }
  void announce(const std::string& path, const char* action) { umockdev_testbed_uevent(bed_, path.c_str(), action); }

 private:
  UMockdevTestbed* bed_;
};

Descriptor finder_plugin() {
  return describe<UsbFinder>("usb_finder", "test");
}

TEST(UsbFinder, finds_what_is_there_and_what_is_plugged_in_and_sees_it_go) {
  PlayedSystem machine;
  const auto first = machine.plug_in("A1", "ttyUSB0");
  machine.add("tty", "ttyS0", nullptr, {}, {"DEVNAME", "/dev/ttyS0"});  // not on USB
  MockInstance finder(finder_plugin());
  ASSERT_TRUE(finder.start()) << finder.error();
  EXPECT_TRUE(finder.host().sees());
  ASSERT_THAT(finder.host().found(), SizeIs(1));
  EXPECT_EQ(finder.host().found().begin()->first, first);
  EXPECT_THAT(finder.host().found().begin()->second,
              IsSupersetOf(PropertyMap{{"kind", "usb"},
                                       {"vendor", "0403"},
                                       {"product", "6001"},
                                       {"serial", "A1"},
                                       {"manufacturer", "FTDI"},
                                       {"model", "FT232R"},
                                       {"interface", "00"},
                                       {"path", "/dev/ttyUSB0"},
                                       {"link", "/dev/serial/by-id/usb-FTDI_A1-if00"}}));
  const auto second = machine.plug_in("B2", "ttyUSB1");
  machine.announce(second, "add");
  ASSERT_TRUE(until(finder, [&] { return finder.host().found().contains(second); }));
  machine.announce(first, "remove");
  ASSERT_TRUE(until(finder, [&] { return !finder.host().found().contains(first); }));
  EXPECT_THAT(finder.host().found(), SizeIs(1));
}

TEST(UsbFinder, finds_whole_devices_and_only_the_subsystems_that_it_is_asked_for) {
  PlayedSystem machine;
  machine.plug_in("A1", "ttyUSB0");
  MockInstance finder(finder_plugin(), {{"subsystems", "usb"}});
  ASSERT_TRUE(finder.start()) << finder.error();
  ASSERT_THAT(finder.host().found(), SizeIs(1));
  EXPECT_EQ(finder.host().found().begin()->second.at("path"), "/dev/bus/usb/001/A1");
  MockInstance wrong(finder_plugin(), {{"subsystems", "tty, a/b"}});
  EXPECT_FALSE(wrong.start());
  EXPECT_THAT(wrong.error(), HasSubstr("names such as tty"));
}

}  // namespace
}  // namespace iotcloud::drivers::usb

/// umockdev takes effect in processes that load its library first.
int main(int argc, char** argv) {
  constexpr const char* preloaded = "libumockdev-preload.so.0";
  if (std::getenv("LD_PRELOAD") == nullptr) {
    setenv("LD_PRELOAD", preloaded, 1);
    execv("/proc/self/exe", argv);
    return EXIT_FAILURE;
  }
  ::testing::InitGoogleMock(&argc, argv);
  return RUN_ALL_TESTS();
}
