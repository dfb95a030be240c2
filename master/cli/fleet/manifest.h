#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/config/yaml.h>

namespace iotcloud::master::cli {

/// One deployment of a manifest: a number of like instances on each of some gateways.
struct Deployment {
  std::string name;    ///< with a gateway and a number from 1 to `count` it names an instance
  std::string plugin;  ///< file name, in the gateways' plugin folder unless it is a file of this machine
  std::string file;    ///< its path on this machine, with a slash, when it is to be sent; empty: it is on the gateways
  std::string sha256;  ///< of that file
  std::string driver;  ///< empty: the plugin's own
  bool all_gateways = false;
  std::vector<std::string> gateways;  ///< unless all
  int count = 1;                      ///< on each gateway
  bool active = true;
  std::map<std::string, std::string> properties;  ///< with those of channels
  std::map<std::string, std::string> metadata;
};

/// A whole fleet as it is wanted (config/fleet.yaml is a commented one).
struct Manifest {
  std::string fleet;  ///< its name: what it deploys is marked with it, and only that is ever taken away
  std::vector<Deployment> deployments;
};

/// Most instances of one deployment on one gateway.
inline constexpr int most_instances = 10'000;

/// A plugin that is a file of this machine.
struct PluginFile {
  std::string path;  ///< with a slash
  std::string sha256;
};
/// Finds the file that a manifest names with a slash. \throws std::exception when it cannot be sent.
using FindPlugin = std::function<PluginFile(const std::string& named)>;

/// \param find_plugin empty: plugins are on the gateways only.
/// \throws config::ConfigError with file, line, key and what would be right; also for keys that are not known.
Manifest read_manifest(config::Section top, const FindPlugin& find_plugin = {});
/// Plugins that it names with a slash are looked for from its own folder on.
Manifest load_manifest(const std::string& file);

}  // namespace iotcloud::master::cli
