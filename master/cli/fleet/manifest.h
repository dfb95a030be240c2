#pragma once

#include <functional>
#include <string>
#include <vector>

#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/records.h>

namespace iotcloud::master::cli {

/// One deployment of a manifest: `count` identical instances on each of its gateways.
struct Deployment : discovery::Deployment {
  std::string file;  ///< the plugin's path on this machine, which contains a slash; empty: the plugin is not sent
  bool all_gateways = false;
  std::vector<discovery::GatewayId> gateways;  ///< used unless all_gateways
  int count = 1;                               ///< on each gateway
};

/// A whole fleet as it is wanted (config/fleet.yaml is a commented one).
struct Manifest {
  std::string fleet;  ///< its name, with which its instances are marked; only marked instances are ever removed
  std::vector<Deployment> deployments;
};

/// Most instances of one deployment on one gateway.
inline constexpr int most_instances = 10'000;

/// A plugin that is a file of this machine.
struct PluginFile {
  std::string path;  ///< with a slash
  std::string sha256;
};
/// Finds the file of a plugin that a manifest names with a slash. \throws std::exception when it cannot be sent.
using FindPlugin = std::function<PluginFile(const std::string& named)>;

/// \param find_plugin empty: a manifest may only name plugins that are on the gateways.
/// \throws config::ConfigError with file, line, key and what would be right; also for unknown keys.
Manifest read_manifest(config::Section top, const FindPlugin& find_plugin = {});
/// Reads a manifest's file. Relative paths of plugins in it start at its own folder.
Manifest load_manifest(const std::string& file);

}  // namespace iotcloud::master::cli
