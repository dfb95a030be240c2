// What anybody may send to the master's API: a master on an embedded registry, whose only gateway is lost, so that no
// order is waited for.
#include <optional>
#include <thread>

#include "iotcloud/config/log.h"
#include "iotcloud/discovery/records.h"
#include "iotcloud/discovery/registry.h"
#include "iotcloud/master/api/api_handler.h"
#include "iotcloud/master/master.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/thrift_frames.h"

using namespace iotcloud;

namespace {

std::unique_ptr<discovery::Registry> fresh_registry() {
  static int number = 0;
  discovery::RegistryOptions options;
  options.url = "embedded://fuzz-master-" + std::to_string(number++);
  return discovery::make_registry(options);
}

class Fleet {
 public:
  Fleet() {
    const discovery::Paths paths;
    discovery::GatewayRecord gateway;
    gateway.id = "lab1";
    gateway.host = "127.0.0.1";
    discovery::put(*registry_, paths.gateway("lab1"), encode(gateway));
    discovery::OrderRecord order;
    order.instance = "0a1b";
    order.plugin = "turtle.so";
    order.name = "robot";
    order.index = 1;
    discovery::put(*registry_, paths.order("lab1", "0a1b"), encode(order));
    discovery::DriverRecord driver;
    driver.name = "turtle";
    driver.instance = "0a1b";
    driver.gateway = "lab1";
    discovery::put(*registry_, paths.instance("turtle", "0a1b"), encode(driver));
    discovery::TopologyRecord topology;
    topology.name = "echo";
    discovery::put(*registry_, paths.topology("echo"), encode(topology));
    master::MasterOptions options;
    options.outcome_timeout = std::chrono::milliseconds(1);
    master_.emplace(*registry_, options);
    while (!master_->status().leading) std::this_thread::yield();
    service_ = master::serve_api(*master_);
  }

  const config::ThriftService& service() const { return service_; }
  /// Orders stay in the registry: so many that it is time for another one.
  bool is_full() { return registry_->children(discovery::Paths().orders("lab1")).value_or(Names{}).size() > 20'000; }

 private:
  using Names = std::vector<std::string>;
  std::unique_ptr<discovery::Registry> registry_ = fresh_registry();
  std::optional<master::Master> master_;
  config::ThriftService service_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  config::set_log_level(config::LogLevel::off);
  static auto fleet = std::make_unique<Fleet>();
  fuzz::serve(fleet->service(), data, size, {});
  if (fleet->is_full()) {
    fleet.reset();
    fleet = std::make_unique<Fleet>();
  }
  return 0;
}
