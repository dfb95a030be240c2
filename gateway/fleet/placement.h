#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/gateway/host/instance_spec.h>

namespace iotcloud::gateway {

/// Spreads channel groups round robin over a broker's servers, all channels of one group on one server
/// (docs/wire.md#topics); the group's other servers follow in their order and are used while that one is unreachable. A
/// group is the exclusive channels of one instance, or the channels that all instances of a driver share. Not thread
/// safe.
class Placement {
 public:
  explicit Placement(std::vector<brokers::BrokerSetting> brokers) : brokers_(std::move(brokers)) {}

  /// Picks servers for a new instance. The shared group of a driver stays where its first instance was placed.
  std::vector<BrokerPlan> place(const discovery::DriverName& driver);
  const std::vector<brokers::BrokerSetting>& brokers() const { return brokers_; }
  /// Remembers the server of the shared group of an instance that already runs.
  void learn(const discovery::DriverName& driver, const std::vector<BrokerPlan>& plans);

 private:
  const std::vector<brokers::BrokerSetting> brokers_;
  /// Index of the next server, by broker and whether it is for shared groups.
  std::map<std::pair<std::string, bool>, std::size_t> next_;
  std::map<std::pair<std::string, discovery::DriverName>, std::string> shared_;  ///< broker and driver -> preferred URL
};

}  // namespace iotcloud::gateway
