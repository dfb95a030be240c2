// A plugin that calls a function that nothing defines.
#include <iotcloud/drivers/plugin.h>

namespace weather {

double calibrated(double reading);

class Station : public iotcloud::drivers::Driver {
 public:
  std::vector<iotcloud::drivers::ChannelSpec> channels(const iotcloud::drivers::PropertyMap&) override { return {}; }
  void open(iotcloud::drivers::DriverContext& context) override {
    context.update_metadata({{"reading", std::to_string(calibrated(1))}});
  }
};

}  // namespace weather

IOTCLOUD_DRIVER(weather::Station, "station", "1")
