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

namespace iotcloud::gateway {
class Gateway;
}

namespace iotcloud::local {

/// The parts of a LocalCluster.
struct LocalOptions {
  /// The name of the embedded broker and registry. Clusters of one process with different names do not see each other.
  std::string name = "local";
  std::vector<discovery::GatewayId> gateways{discovery::GatewayId("gateway-1")};
  /// Logical brokers of all gateways and the URL of each; the first is the default; an empty URL is the embedded
  /// broker. So a topology that names "rabbitmq" runs unchanged.
  std::vector<std::pair<std::string, std::string>> brokers{{"rabbitmq", ""}};
  std::string registry_url;  ///< empty: the embedded registry
  /// All records of the cluster are below this path of the registry, which belongs to it alone ("/my-run"): it meets no
  /// fleet there. stop() undeploys its drivers, and the destructor removes the path. Empty: the cluster uses the usual
  /// paths, and leaves its records there.
  std::string own_root{};
  std::vector<std::string> library_folders;  ///< more folders of topologies' component libraries
  std::string plugin_dir;  ///< folder of drivers' and topologies' plugins; may be empty if all are linked in
  /// Linked-in drivers, by the name that deploy() takes. They must outlive the cluster.
  std::map<std::string, const drivers::Descriptor*> drivers;
  const config::Clock* clock = nullptr;  ///< nullptr: the system's
  config::Metrics* metrics = nullptr;    ///< nullptr: the process's
};

/// Everything in one process: registry, broker, master, gateways with their drivers, and topology workers. For the
/// first run, tests and debugging. A driver or bolt that crashes ends the process. Thread safe, except for the
/// destructor.
class LocalCluster {
 public:
  /// Starts the master and the gateways; returns when the master leads. \throws config::Error if it does not lead
  /// within ten seconds (because the registry is away).
  explicit LocalCluster(LocalOptions options);
  /// Calls stop() with a limit of five seconds if it was not called.
  ~LocalCluster();

  /// Runs one more worker of the topology in this YAML file, with this cluster's registry instead of the file's. Looks
  /// for component libraries beside the file and in `plugin_dir`.
  /// \param components linked-in components, in addition to those of the libraries. \return the worker, which lives as
  /// long as the cluster. \throws config::ConfigError, config::Error.
  topology::Worker& run_topology(const std::string& yaml_file, topology::ComponentRegistry components = {});
  topology::Worker& run_topology(topology::TopologyDefinition definition, topology::ComponentRegistry components = {});

  /// Deploys one instance and waits until it is active. \param plugin a file in `plugin_dir`, or a name in `drivers`.
  /// \param gateway empty: the first one. \throws config::Error with the reason of a
  /// failure.
  discovery::InstanceId deploy(const std::string& plugin, const std::map<std::string, std::string>& properties = {},
                               const discovery::GatewayId& gateway = {});
  /// Undeploys an instance and waits until it is gone. \throws config::Error with the reason of a failure.
  void undeploy(const discovery::InstanceId& instance);

  /// Stops topologies, then gateways, then the master, within `limit`. With LocalOptions::own_root the drivers are
  /// undeployed before. \return false if one of them did not stop in
  /// time. Later calls return the answer of the first.
  bool stop(std::chrono::milliseconds limit);

  master::Master& master();
  /// The gateway of that id; null: there is none.
  gateway::Gateway* gateway(const discovery::GatewayId& id);
  /// The worker of that name; null: there is none.
  topology::Worker* worker(const std::string& name);
  discovery::Registry& registry();
  const discovery::Paths& paths() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::local
