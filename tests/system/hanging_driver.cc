#include <cstdio>
#include <vector>

#include <unistd.h>

#include <iotcloud/drivers/plugin.h>

namespace iotcloud::tests {

/// A driver that never returns from open(), as one whose device does not answer.
class HangingDriver final : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap&) override { return {}; }
  void open(drivers::DriverContext&) override {
    std::puts("the driver hangs");
    std::fflush(stdout);
    for (;;) ::pause();
  }
};

}  // namespace iotcloud::tests

IOTCLOUD_DRIVER(iotcloud::tests::HangingDriver, "hanging", "1.0")
