// A plugin whose bytes name another driver than its code does.
#include <iotcloud/drivers/plugin.h>

namespace iotcloud::gateway {

class LiarDriver final : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override { return {}; }
  void open(drivers::DriverContext&) override {}
};

}  // namespace iotcloud::gateway

extern "C" __attribute__((visibility("default"))) const iotcloud::drivers::Descriptor* iotcloud_driver_descriptor() {
  static const auto descriptor = iotcloud::drivers::describe<iotcloud::gateway::LiarDriver>("turtle", "1");
  return &descriptor;
}
extern "C" __attribute__((visibility("default"), used)) const char iotcloud_driver_sdk_mark[] =
    IOTCLOUD_DRIVER_SDK_MARK IOTCLOUD_STRINGIFY(IOTCLOUD_DRIVER_SDK_VERSION) ";";
extern "C" __attribute__((visibility("default"), used)) const auto iotcloud_driver_card =
    iotcloud::drivers::detail::card_with_mark("liar", "1");
