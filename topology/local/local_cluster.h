#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/drivers/plugin.h>
#include <iotcloud/master/master.h>
#include <iotcloud/topology/worker/worker.h>

namespace iotcloud::local {

struct LocalOptions {
  /// Of the embedded broker and registry: clusters of one process with different names do not see each other.
  std::string name = "local";
  std::vector<std::string> gateways{"gateway-1"};
  /// Logical brokers of all gateways, the first one being the default, and the URL that serves each; empty: the
  /// embedded broker. So a topology that says "rabbitmq" runs unchanged.
  std::vector<std::pair<std::string, std::string>> brokers{{"rabbitmq", ""}};
  std::string registry_url;  ///< empty: the embedded registry
  std::string plugin_dir;    ///< where drivers' and topologies' plugins are; may be empty when all are linked in
  /// Drivers that are linked in, by the name that deploy() gives. They outlive the cluster.
  std::map<std::string, const drivers::Descriptor*> drivers;
  const config::Clock* clock = nullptr;  ///< nullptr: the system's
  config::Metrics* metrics = nullptr;    ///< nullptr: the process's
};

/// Everything in one process: registry, broker, master, gateways with their drivers, and topology workers. For the
/// first run, tests and debugging. A driver or bolt that crashes takes the process with it. Thread safe, but for the
/// destructor.
class LocalCluster {
 public:
  /// Starts the master and the gateways; returns when the master leads. \throws config::Error when it does not within
  /// ten seconds (a registry that is away).
  explicit LocalCluster(LocalOptions options);
  /// Stops with a limit of five seconds unless stopped.
  ~LocalCluster();

  /// Runs one more worker of the topology in this YAML file, with this cluster's registry instead of the one that the
  /// file names. Component libraries are looked for beside the file and in `plugin_dir`.
  /// \param components linked in, in addition. The worker lives as long as the cluster.
  /// \throws config::ConfigError, config::Error.
  topology::Worker& run_topology(const std::string& yaml_file, topology::ComponentRegistry components = {});
  topology::Worker& run_topology(topology::TopologyDefinition definition, topology::ComponentRegistry components = {});

  /// Deploys one instance and waits until it is active. \param plugin a file in `plugin_dir`, or a name in `drivers`.
  /// \param gateway empty: the first one. \return its id. \throws config::Error with the reason when it is not.
  std::string deploy(const std::string& plugin, const std::map<std::string, std::string>& properties = {},
                     const std::string& gateway = "");
  /// Waits until it is gone. \throws config::Error with the reason when it is not.
  void undeploy(const std::string& instance);

  /// Stops topologies, then gateways, then the master, within `limit`. \return false when something had to be left
  /// undone. Once; later calls answer the same.
  bool stop(std::chrono::milliseconds limit);

  master::Master& master();
  discovery::Registry& registry();
  const discovery::Paths& paths() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::local
