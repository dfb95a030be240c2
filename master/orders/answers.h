#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/discovery/carried_messages.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/known_plugin.h>
#include <iotcloud/master/orders/orders.h>

/// A master's answers to questions and to clients that send plugins; the daemon and its clients share these structs.
namespace iotcloud::master {

/// The state of a master.
struct MasterStatus {
  std::string id;
  bool leading = false;
  std::int64_t epoch = 0;      ///< of this master's orders; 0 while it does not lead
  std::string leader;          ///< host:port of the master that leads; empty: none, or not known
  bool registry_away = false;  ///< no connection to the registry now
  static constexpr const char* what = "the status of a master";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(id, usual), IOTCLOUD_FIELD(leading, usual), IOTCLOUD_FIELD(epoch, usual),
                 IOTCLOUD_FIELD(leader, usual), IOTCLOUD_FIELD_AS(registry_away, usual, "registry_away", registryAway)};
};

/// The order of one instance as a client may see it.
struct ListedOrder : discovery::PlacedOrder {
  /// Keys of properties whose values only an admin may see; they are missing in `properties`.
  std::vector<std::string> hidden;
  static constexpr const char* what = "the order of an instance";
  static constexpr auto fields = std::tuple_cat(
      std::tuple{IOTCLOUD_FIELD(gateway, usual), IOTCLOUD_FIELD_AS(order.instance, usual, "instance", instance),
                 IOTCLOUD_FIELD_AS(order.index, rare, "index", index)},
      IOTCLOUD_FIELDS_OF(order, discovery::Deployment), std::tuple{IOTCLOUD_FIELD(hidden, usual)});
};

/// One change of state of one driver instance, as a gateway remembers it.
struct DriverChange {
  discovery::GatewayId gateway;
  discovery::InstanceId instance;
  discovery::DriverName driver;
  std::string state;
  std::string reason;
  std::int64_t time_ms = 0;  ///< wall time
  static constexpr const char* what = "a change of state";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD_AS(time_ms, usual, "time_ms", timeMs),
                                            IOTCLOUD_FIELD(gateway, usual),
                                            IOTCLOUD_FIELD(instance, usual),
                                            IOTCLOUD_FIELD(driver, usual),
                                            IOTCLOUD_FIELD(state, usual),
                                            IOTCLOUD_FIELD(reason, usual)};
};

/// Changes of state of driver instances, of several gateways.
struct DriverHistory {
  std::vector<DriverChange> changes;                   ///< the oldest first
  std::map<discovery::GatewayId, std::string> silent;  ///< the gateways that did not answer, each with the reason
  static constexpr const char* what = "a history";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(changes, usual), IOTCLOUD_FIELD(silent, usual)};
};

/// A part of what a driver host has logged.
struct LogPart {
  std::string text;
  std::string position;  ///< where the next part begins: pass it to the next read
  static constexpr const char* what = "a part of a log";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(text, usual), IOTCLOUD_FIELD(position, usual)};
};

/// A plugin, and a gateway that has it.
struct GatewayPlugin {
  discovery::GatewayId gateway;
  discovery::KnownPlugin plugin;
  static constexpr const char* what = "a plugin of a gateway";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(gateway, usual), IOTCLOUD_FIELD(plugin, usual)};
};

/// What a driver host of a gateway has carried.
struct CarriedByGateway {
  discovery::GatewayId gateway;
  discovery::CarriedMessages messages;
};

/// The plugins of several gateways.
struct GatewayPlugins {
  std::vector<GatewayPlugin> plugins;
  std::map<discovery::GatewayId, std::string> silent;  ///< the gateways that did not answer, each with the reason
  static constexpr const char* what = "a list of plugins";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(plugins, usual), IOTCLOUD_FIELD(silent, usual)};
};

/// A plugin's file.
struct PluginOffer {
  std::string plugin;     ///< plain file name
  std::string sha256;     ///< of all its bytes
  std::int64_t size = 0;  ///< bytes
  std::string signature;  ///< empty: not signed
  static constexpr const char* what = "the offer of a plugin";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(plugin, required), IOTCLOUD_FIELD(sha256, required),
                                            IOTCLOUD_FIELD(size, required), IOTCLOUD_FIELD(signature, usual)};
};

/// How far a plugin has come at one gateway.
struct UploadTarget {
  discovery::GatewayId gateway;
  std::string problem;  ///< why the gateway does not get the plugin; empty: it takes it, or has it
  bool has = false;     ///< the gateway has the plugin
  static constexpr const char* what = "a receiver of a plugin";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(gateway, usual), IOTCLOUD_FIELD(problem, usual), IOTCLOUD_FIELD(has, usual)};
};

/// The answer to a piece of an upload.
struct UploadResult {
  OrderResult refusal{};                ///< why the master passed nothing on; OrderRefusal::none: it did
  std::string upload{};                 ///< the upload's id; empty: no gateway needs (more) pieces
  std::vector<UploadTarget> targets{};  ///< one for each gateway to which the plugin was offered
  static constexpr const char* what = "an answer to an upload";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD_AS(refusal.refusal, usual, "refusal", refusal),
                                            IOTCLOUD_FIELD_AS(refusal.leader, rare, "leader", leader),
                                            IOTCLOUD_FIELD(upload, usual), IOTCLOUD_FIELD(targets, usual)};

  /// One line for people: "lab1 has it; lab2: it is lost".
  std::string summary() const;
};

}  // namespace iotcloud::master
