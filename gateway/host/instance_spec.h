#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/discovery/records.h>

namespace iotcloud::gateway {

/// A logical broker of the gateway as one instance sees it: the gateway has already picked the server for each channel
/// group, so all hosts together spread their groups round robin (REFERENCE.md 3).
struct BrokerPlan {
  std::string name;                         ///< logical ("rabbitmq"): ChannelSpec::broker, ChannelRecord::transport
  std::string type;                         ///< kind of broker ("embedded", "rabbitmq")
  brokers::BrokerOptions options;           ///< how to connect: without URLs, clock and metrics
  std::vector<std::string> exclusive_urls;  ///< for this instance's own channels, the preferred server first
  std::vector<std::string> shared_urls;     ///< for the channels that all instances of the driver share
  friend bool operator==(const BrokerPlan&, const BrokerPlan&) = default;
};

/// All that a driver host needs to run one instance.
struct InstanceSpec {
  discovery::OrderRecord order;
  std::vector<BrokerPlan> brokers;  ///< the first is the default
  friend bool operator==(const InstanceSpec&, const InstanceSpec&) = default;
};

/// Which bytes a plugin is.
struct PluginIdentity {
  std::string sha256{};     ///< empty: not known
  std::string signed_by{};  ///< the trusted key; empty: none
  friend bool operator==(const PluginIdentity&, const PluginIdentity&) = default;
};

/// What a host is started for.
struct HostOrder {
  std::string plugin;         ///< plain file name ("turtle.so")
  std::string gateway;        ///< id
  bool isolated = false;      ///< for one instance only (`isolation: instance`)
  std::string sha256{};       ///< as ordered, of a plugin that was sent; empty: of the gateway's plugin folder
  PluginIdentity identity{};  ///< as found when it was started
};

/// What a driver host says of one instance.
struct InstanceStatus {
  std::string instance;
  std::string driver;  ///< the order's name, or else the plugin's own
  discovery::DriverState state = discovery::DriverState::deployed;
  std::string reason;         ///< why it is in this state, for people
  std::int64_t since_ms = 0;  ///< wall time of the last change
  std::vector<discovery::ChannelRecord> channels;
  std::map<std::string, std::string> metadata;  ///< what the driver itself says
  PluginIdentity plugin{};                      ///< said by the fleet, not by the host
  friend bool operator==(const InstanceStatus&, const InstanceStatus&) = default;
};

/// An event thread of a driver host that has not come round for a while.
struct Stall {
  std::string instance;     ///< whose callback runs; empty: not known
  bool own_thread = false;  ///< the thread is this instance's own (`thread: own`)
  std::chrono::milliseconds time{0};
  /// After how long it hangs, as the instance's property `hang_limit` says; 0: never. nullopt: as the gateway says.
  std::optional<std::chrono::milliseconds> limit;
  friend bool operator==(const Stall&, const Stall&) = default;
};

/// An instance as its host knows it: what was ordered and what is.
struct HostedInstance {
  InstanceSpec spec;
  InstanceStatus status;
};

}  // namespace iotcloud::gateway
