#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/config/declaration.h>
#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/master/cli/fleet/instance_properties.h>

namespace iotcloud::master::cli {

/// One deployment of a manifest: `count` instances on each of its gateways, which differ in `own` properties only.
struct ManifestDeployment : discovery::Deployment {
  std::string file;  ///< the plugin's path on this machine, which contains a slash; empty: the plugin is not sent
  bool all_gateways = false;
  std::vector<discovery::GatewayId> gateways;  ///< used unless all_gateways
  int count = 1;                               ///< on each gateway
  /// By number: the properties in which the instances differ.
  std::map<int, Texts> own{};
  /// Where properties stand in the manifest; with the empty name where the deployment does.
  std::map<std::string, config::Location> places{};
  std::string each_file{};                            ///< the CSV file of `each`; empty: there is none
  std::vector<config::DriverDeclaration> declared{};  ///< what the plugin's file declares; empty: it is not sent

  /// All properties of the instance with this number.
  Texts properties_of(int index) const;
  /// Where a property of the instance with this number stands, or where it is missing.
  config::Location place_of(const std::string& property, int index) const;
};

/// A topology of a manifest, which pools of workers are to run.
struct ManifestTopology {
  discovery::TopologyName name;
  std::string file;  ///< its YAML's path on this machine
  int workers = 1;
  config::Location place{};  ///< where it stands in the manifest
  std::string digest{};      ///< of its YAML and libraries, once they were looked at; empty before
};

/// A whole fleet as it is wanted (config/fleet.yaml is a commented one).
struct Manifest {
  std::string fleet;  ///< its name, with which its instances are marked; only marked instances are ever removed
  std::vector<ManifestDeployment> deployments;
  std::vector<ManifestTopology> topologies;
};

/// Most workers of one topology.
inline constexpr int most_topology_workers = 1000;

/// Most instances of one deployment on one gateway.
inline constexpr int most_instances = 10'000;

/// A plugin that is a file of this machine.
struct PluginFile {
  std::string path;  ///< with a slash
  std::string sha256;
  config::DriverDeclaration declaration{};
};
/// Finds the file of a plugin that a manifest names with a slash. \throws std::exception when it cannot be sent.
using FindPlugin = std::function<PluginFile(const std::string& named)>;

/// Reads a file that a manifest names, relative to the manifest. \throws std::exception when it cannot be read.
using ReadFile = std::function<std::string(const std::string& named)>;

/// \param read_file empty: a manifest may name no file of properties.
/// \param find_plugin empty: a manifest may only name plugins that are on the gateways.
/// \throws config::ConfigError with file, line, key and what would be right; also for unknown keys.
Manifest read_manifest(config::YamlSection top, const FindPlugin& find_plugin = {}, const ReadFile& read_file = {});
/// Reads a manifest's file. Relative paths of plugins in it start at its own folder.
Manifest load_manifest(const std::string& file);

}  // namespace iotcloud::master::cli
