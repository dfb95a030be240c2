#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/submissions.h>

namespace iotcloud::master {

/// The orders of one gateway.
struct GatewayBackup {
  discovery::GatewayId gateway;
  bool draining = false;
  std::vector<discovery::OrderRecord> orders;
  static constexpr const char* what = "a gateway in a backup";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(gateway, required), IOTCLOUD_FIELD(draining, rare), IOTCLOUD_FIELD(orders, usual)};
  friend bool operator==(const GatewayBackup&, const GatewayBackup&) = default;
};

/// The order of one topology.
struct TopologyBackup {
  discovery::TopologyName topology;
  discovery::TopologyOrder order;
  static constexpr const char* what = "a topology in a backup";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(topology, required), IOTCLOUD_FIELD(order, required)};
  friend bool operator==(const TopologyBackup&, const TopologyBackup&) = default;
};

/// A plugin that was sent to gateways and that orders name.
struct SentPluginBackup {
  std::string plugin;  ///< plain file name
  std::string sha256;
  std::vector<discovery::GatewayId> gateways;  ///< whose orders name it
  static constexpr const char* what = "a plugin in a backup";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(plugin, required), IOTCLOUD_FIELD(sha256, required), IOTCLOUD_FIELD(gateways, usual)};
  friend bool operator==(const SentPluginBackup&, const SentPluginBackup&) = default;
};

/// Everything that people ordered and the registry keeps; what gateways and workers report is not in it, because they
/// write that again by themselves. JSON, for people too. It has the properties of deployments, hence their secrets.
struct Backup {
  static constexpr int current_format = 1;
  int format = current_format;
  std::int64_t made_ms = 0;  ///< Unix time
  std::vector<GatewayBackup> gateways;
  std::vector<TopologyBackup> topologies;
  std::vector<SentPluginBackup> missing_plugins;   ///< needed too: the backup has their names, and not their bytes
  std::vector<discovery::Submission> submissions;  ///< topologies that pools run; their libraries are not in it either
  static constexpr const char* what = "a backup of the registry";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(format, required),      IOTCLOUD_FIELD(made_ms, usual),
                                            IOTCLOUD_FIELD(gateways, usual),       IOTCLOUD_FIELD(topologies, usual),
                                            IOTCLOUD_FIELD(missing_plugins, rare), IOTCLOUD_FIELD(submissions, rare)};
  friend bool operator==(const Backup&, const Backup&) = default;
};

/// The order "import".
struct ImportRequest : Backup {
  bool replace = false;  ///< an order of the backup takes the place of another one that stands in the registry
  static constexpr const char* what = "an order to import a backup";
  static constexpr auto fields = std::tuple_cat(Backup::fields, std::tuple{IOTCLOUD_FIELD(replace, usual)});
};

/// The plugins that were sent and that the orders name, by name and content.
std::vector<SentPluginBackup> sent_plugins(const std::vector<GatewayBackup>& gateways);
/// The component libraries that the submitted topologies name, each once.
std::vector<discovery::SentLibrary> sent_libraries(const Backup& backup);
/// "turtle.so (SHA-256 0123456789ab..., gateways lab1, lab2)"
std::string words(const SentPluginBackup& plugin);
/// "3 orders of 2 gateways, 1 of topologies"
std::string words(const Backup& backup);
/// JSON, indented.
std::string encode(const Backup& backup);
/// \param path says in messages where the text came from. \throws config::Error when it cannot be read, has another
/// format, or names that the registry cannot have.
Backup decode_backup(const std::string& text, const std::string& path);
/// \throws config::Error for another format, and for names that the registry cannot have.
void check(const Backup& backup, const std::string& path);
/// Cuts a backup into some that have orders of up to `bytes` in all, or one order.
std::vector<Backup> pieces_of(const Backup& backup, std::size_t bytes);

}  // namespace iotcloud::master
