#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/discovery/records.h>

namespace iotcloud::gateway {

/// A logical broker of the gateway as one instance sees it: the gateway has already picked the server for each channel
/// group, so all hosts together spread their groups round robin (docs/wire.md#topics).
struct BrokerPlan {
  std::string name;                         ///< logical ("rabbitmq"): ChannelSpec::broker, ChannelRecord::transport
  std::string type;                         ///< kind of broker ("embedded", "rabbitmq")
  brokers::BrokerOptions options;           ///< how to connect; URLs, clock and metrics are not set
  std::vector<std::string> exclusive_urls;  ///< for this instance's exclusive channels; the preferred server is first
  std::vector<std::string> shared_urls;     ///< for the channels that all instances of the driver share
  static constexpr const char* what = "a broker of an instance";
  static constexpr auto fields = std::tuple{
      IOTCLOUD_FIELD(name, required),
      IOTCLOUD_FIELD(type, required),
      IOTCLOUD_FIELD_AS(options.user, required, "user", user),
      IOTCLOUD_FIELD_AS(options.password_file, required, "password_file", passwordFile),
      IOTCLOUD_FIELD_AS(options.password_variable, required, "password_variable", passwordVariable),
      IOTCLOUD_FIELD_AS(options.tls.ca_file, required, "ca", ca),
      IOTCLOUD_FIELD_AS(options.tls.certificate_file, required, "certificate", certificate),
      IOTCLOUD_FIELD_AS(options.tls.key_file, required, "key", key),
      IOTCLOUD_FIELD_AS(options.tls.revoked_file, rare, "revoked", revoked),
      IOTCLOUD_FIELD_AS(options.properties, required, "properties", properties),
      IOTCLOUD_FIELD_AS(options.heartbeat, required, "heartbeat_ms", heartbeatMs),
      IOTCLOUD_FIELD_AS(exclusive_urls, required, "own", own),
      IOTCLOUD_FIELD_AS(shared_urls, required, "shared", shared),
  };
  friend bool operator==(const BrokerPlan&, const BrokerPlan&) = default;
};

/// The form of an order as text, which is that of its node in the registry.
struct AsOrderText {
  static std::string to(const discovery::OrderRecord& order) { return discovery::encode(order); }
  static void from(const std::string& text, discovery::OrderRecord& order) {
    order = discovery::decode_order(text, "an order to a driver host");
  }
};

/// All that a driver host needs to run one instance.
struct InstanceSpec {
  discovery::OrderRecord order;
  std::vector<BrokerPlan> brokers;  ///< the first is the default
  static constexpr const char* what = "what an instance needs";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD_IN(AsOrderText, order, required, "order", order), IOTCLOUD_FIELD(brokers, required)};
  friend bool operator==(const InstanceSpec&, const InstanceSpec&) = default;
};

/// Why an instance is removed from its host.
enum class Removal {
  replaced,    ///< the instance will be created again: here, in another host, or in a later run of the gateway
  undeployed,  ///< its order is gone
};
/// The number of `undeployed` in JSON (discovery/description/json.h) is 1; `replaced` is any other.
inline int json_value(Removal removal) {
  return removal == Removal::undeployed ? 1 : 0;
}
/// Reads what json_value() wrote.
inline void parse(int number, Removal& removal) {
  removal = number == 1 ? Removal::undeployed : Removal::replaced;
}

/// Identifies the bytes of a plugin.
struct PluginIdentity {
  std::string sha256{};     ///< empty: not known
  std::string signed_by{};  ///< the trusted key that signed it; empty: none
  /// The driver's name in these bytes, or else in the file's name; empty: not known. A host does not pass it on.
  discovery::DriverName driver{};
  friend bool operator==(const PluginIdentity&, const PluginIdentity&) = default;
};

/// The form of a plugin's identity as a pair: its checksum, and who signed it.
struct AsIdentityPair {
  static std::pair<std::string, std::string> to(const PluginIdentity& plugin) {
    return {plugin.sha256, plugin.signed_by};
  }
  static void from(const std::pair<std::string, std::string>& pair, PluginIdentity& plugin) {
    plugin = {pair.first, pair.second, {}};
  }
};

/// The arguments with which a gateway starts a host.
struct HostOrder {
  std::string plugin;  ///< plain file name ("turtle.so")
  discovery::GatewayId gateway;
  bool isolated = false;  ///< for one instance only (`isolation: instance`)
  /// The SHA-256 in the order, for an uploaded plugin; empty: the plugin is in the gateway's plugin folder.
  std::string sha256{};
  PluginIdentity identity{};  ///< the bytes found when the host was started
  /// The order that starts the host is one of an update, which may go back. Not passed on to the host.
  bool of_update = false;
  /// The property `network` of the deployment: what the host may connect to. Not passed on to the host.
  std::optional<std::string> network{};
  static constexpr const char* what = "the order for a driver host";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(plugin, required), IOTCLOUD_FIELD(gateway, required),
                                            IOTCLOUD_FIELD(isolated, required), IOTCLOUD_FIELD(sha256, usual),
                                            IOTCLOUD_FIELD_IN(AsIdentityPair, identity, usual, "found", found)};
};

/// A driver host's report about one instance.
struct InstanceStatus {
  discovery::InstanceId instance;
  discovery::DriverName driver;  ///< the order's name, or else the plugin's own
  discovery::DriverState state = discovery::DriverState::deployed;
  std::string reason;         ///< why it is in this state, for people
  std::int64_t since_ms = 0;  ///< wall time of the last change
  std::vector<discovery::ChannelRecord> channels;
  std::map<std::string, std::string> metadata;  ///< the metadata that the driver itself reports
  PluginIdentity plugin{};                      ///< set by the fleet, not by the host
  bool starts_again = false;                    ///< it failed, and the fleet starts it again; set by the fleet
  static constexpr const char* what = "the status of an instance";
  static constexpr auto fields = std::tuple{
      IOTCLOUD_FIELD(instance, required), IOTCLOUD_FIELD(driver, required),   IOTCLOUD_FIELD(state, required),
      IOTCLOUD_FIELD(reason, required),   IOTCLOUD_FIELD(since_ms, required), IOTCLOUD_FIELD(channels, required),
      IOTCLOUD_FIELD(metadata, usual),  // an older host does not send it
  };
  friend bool operator==(const InstanceStatus&, const InstanceStatus&) = default;
};

/// An event thread of a driver host that is stuck in a callback.
struct Stall {
  discovery::InstanceId instance;  ///< the instance whose callback runs; empty: not known
  bool own_thread = false;         ///< the thread is this instance's own (`thread: own`)
  std::chrono::milliseconds time{0};
  /// The instance's property `hang_limit`: the time after which it counts as hanging; 0: never. nullopt: the gateway's
  /// limit applies.
  std::optional<std::chrono::milliseconds> limit;
  static constexpr const char* what = "an event thread that is stuck";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(instance, required), IOTCLOUD_FIELD(own_thread, required),
                 IOTCLOUD_FIELD_AS(time, required, "ms", ms), IOTCLOUD_FIELD_AS(limit, rare, "limit_ms", limitMs)};
  friend bool operator==(const Stall&, const Stall&) = default;
};

/// An instance as its host knows it: what was ordered, and the current status.
struct HostedInstance {
  InstanceSpec spec;
  InstanceStatus status;
  static constexpr const char* what = "an instance of a driver host";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(spec, required), IOTCLOUD_FIELD(status, required)};
};

}  // namespace iotcloud::gateway
