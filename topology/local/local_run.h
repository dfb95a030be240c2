#pragma once

#include <map>
#include <stop_token>
#include <string>
#include <vector>

#include <iotcloud/topology/local/local_cluster.h>

namespace iotcloud::local {

/// The drivers and the topology that `iotcloud run` runs.
struct RunOptions {
  std::string topology;              ///< its YAML file
  std::vector<std::string> plugins;  ///< files of driver plugins, all in one folder
  int count = 1;                     ///< instances of each plugin
  std::map<std::string, std::string> properties;
  std::string broker_url;                    ///< for all logical brokers of the topology; empty: the embedded broker
  std::string registry_url;                  ///< empty: the embedded registry
  std::vector<std::string> library_folders;  ///< of component libraries, besides those of the file and the plugins
};

/// The files that a run reads: the topology's, plugins, and where its component libraries may be.
std::vector<std::string> files_of(const RunOptions& options);

/// A topology and its drivers in this process, on a broker and a registry that need no server, for a person who
/// develops them. The files run on a cluster unchanged. Used on one thread.
class LocalRun {
 public:
  /// Starts all of it; returns when the instances are active. \param stop when it is requested, this waits for no
  /// driver any more, and throws. \throws config::Error, config::ConfigError.
  explicit LocalRun(const RunOptions& options, const std::stop_token& stop = {});

  /// A line for each spout and bolt whose driver none of the plugins is: nothing comes from it, or goes to it. Empty
  /// with a registry that is not embedded, because the driver may be elsewhere.
  const std::vector<std::string>& without_driver() const { return without_driver_; }
  /// The events since the last call, a line for each: how many instances are in which state, and what each component
  /// of the topology took and emitted a second, with its newest tuple.
  std::vector<std::string> news();
  LocalCluster& cluster() { return cluster_; }
  /// \return false when something did not stop within the limit.
  bool stop(std::chrono::milliseconds limit) { return cluster_.stop(limit); }

 private:
  void find_without_driver(const RunOptions& options);
  std::string instances();
  std::string newest(const std::string& component);

  LocalCluster cluster_;
  topology::Worker* worker_;  ///< the cluster's
  std::vector<std::string> without_driver_;
  topology::Snapshot before_;
  std::chrono::steady_clock::time_point at_ = std::chrono::steady_clock::now();
};

}  // namespace iotcloud::local
