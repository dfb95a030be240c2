// Hostile calls of gateways of the original system, or of anybody in their place, to a master.
#include "iotcloud/config/log.h"
#include "iotcloud/discovery/records.h"
#include "iotcloud/discovery/registry.h"
#include "iotcloud/master/master.h"
#include "iotcloud/master/originals/gateway_handler.h"
#include "iotcloud/master/originals/original_gateways.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include "iotcloud/tests/fuzz/thrift_frames.h"

using namespace iotcloud;

namespace {

class Originals {
 public:
  const rpc::ThriftService& service() const { return service_; }
  /// Each gateway has a thread, and its records stay in the registry.
  bool is_full() { return registry_->children(discovery::Paths().gateways).value_or(Names{}).size() > 50; }

 private:
  using Names = std::vector<std::string>;
  static std::unique_ptr<discovery::Registry> fresh_registry() {
    static int number = 0;
    discovery::RegistryOptions options;
    options.url = "embedded://fuzz-originals-" + std::to_string(number++);
    return discovery::make_registry(options);
  }
  static master::OriginalGatewaysOptions never_called() {
    master::OriginalGatewaysOptions options;
    options.heartbeat_interval = std::chrono::hours(24);  // no call to the addresses in the inputs
    return options;
  }

  std::unique_ptr<discovery::Registry> registry_ = fresh_registry();
  master::OriginalGateways gateways_{*registry_, never_called()};
  rpc::ThriftService service_ = master::serve_original_gateways(gateways_,
                                                                [] {
                                                                  master::MasterStatus status;
                                                                  status.leading = true;
                                                                  return status;
                                                                },
                                                                {.open = true, .calls = {}});
};

}  // namespace

IOTCLOUD_FUZZ_TARGET(master_gateways, 3'000) {
  config::set_log_level(config::LogLevel::off);
  static auto originals = std::make_unique<Originals>();
  fuzz::serve(originals->service(), data, size, {});
  if (originals->is_full()) {
    originals.reset();
    originals = std::make_unique<Originals>();
  }
}
