#include <set>

#include <iotcloud/discovery/driver_of_file.h>
#include <iotcloud/master/listing/lost_orders.h>

namespace iotcloud::master {

namespace {

/// The driver's name as far as the order tells it. If the order names none, the plugin's file name stands for the
/// plugin's own name, which only a process that loads the plugin knows.
discovery::DriverName driver_of_order(const discovery::OrderRecord& order) {
  if (!order.driver.empty()) return order.driver;
  return discovery::driver_of_file(order.plugin);
}

}  // namespace

std::vector<discovery::DriverRecord> lost_orders(discovery::Registry& registry, const discovery::Paths& paths,
                                                 const std::vector<discovery::DriverRecord>& drivers) {
  std::vector<discovery::DriverRecord> waiting;
  std::vector<discovery::GatewayId> lost;
  for (const auto& gateway : discovery::list_gateways(registry, paths)) {
    if (!gateway.alive) lost.push_back(gateway.record.id);
  }
  if (lost.empty()) return waiting;
  std::set<discovery::InstanceId> known;
  for (const auto& driver : drivers) known.insert(driver.instance);
  for (const auto& [gateway, order] : discovery::list_orders(registry, paths, lost)) {
    if (known.contains(order.instance) || !order.made_by.empty()) continue;
    discovery::DriverRecord record;
    record.name = driver_of_order(order);
    record.instance = order.instance;
    record.gateway = gateway;
    record.state = discovery::DriverState::ordered;
    record.reason = "ordered; its gateway is lost, and follows when it comes back";
    record.metadata = order.metadata;
    record.deployment = order.name;
    record.index = order.index;
    record.plugin = order.plugin;
    record.sha256 = order.sha256;
    waiting.push_back(std::move(record));
  }
  return waiting;
}

}  // namespace iotcloud::master
