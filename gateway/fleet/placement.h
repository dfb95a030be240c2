#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/gateway/host/instance_spec.h>

namespace iotcloud::gateway {

/// Spreads channel groups round robin over a broker's servers, all channels of one group on one server (REFERENCE.md
/// 3); the other servers follow in turn, for while that one is away. A group is what one instance has for itself, or
/// what all instances of a driver share. Not thread safe.
class Placement {
 public:
  explicit Placement(std::vector<brokers::BrokerSetting> brokers) : brokers_(std::move(brokers)) {}

  /// Picks servers for a new instance. The shared group of a driver stays where its first instance was placed.
  std::vector<BrokerPlan> place(const std::string& driver);
  /// Remembers where the shared group of an instance that runs already is.
  void learn(const std::string& driver, const std::vector<BrokerPlan>& plans);

 private:
  const std::vector<brokers::BrokerSetting> brokers_;
  std::map<std::pair<std::string, bool>, std::size_t> next_;           ///< by broker and whether for shared groups
  std::map<std::pair<std::string, std::string>, std::string> shared_;  ///< broker and driver -> preferred URL
};

}  // namespace iotcloud::gateway
