#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/runtime/runtime.h>
#include <iotcloud/topology/worker/pages.h>

namespace iotcloud::topology {

class Fence;

struct WorkerOptions {
  TopologyDefinition definition;
  /// Components that are linked in, in addition to those of `topology.library`.
  ComponentRegistry components;
  /// Where component libraries are looked for when they are not found relative to the YAML file; in this order.
  std::vector<std::string> library_folders;
  /// Used instead of what the YAML says. Not owned: outlives the worker. nullptr: the worker connects by itself.
  discovery::Registry* registry = nullptr;
  const config::Clock* clock = nullptr;  ///< nullptr: the system's
  config::Metrics* metrics = nullptr;    ///< nullptr: the process's
  /// Called once, on a thread of the worker, when an order killed the topology: it has drained, stopped and left the
  /// registry, and the process may end. May be empty.
  std::function<void()> on_killed = {};
  /// Beaten by whoever gives it. Null: the worker's own, by the heartbeats of its brokers and the system's clock.
  std::shared_ptr<Fence> fence = {};
};

/// One process's part of a topology: reads and sends through brokers, runs the graph, shares the channels with other
/// workers of the same topology, and does what is ordered in the registry (worker_control.h). Thread safe.
class Worker final : public config::Service {
 public:
  /// Loads the component libraries and checks the merged graph; connects nowhere.
  /// \throws config::ConfigError, config::Error.
  explicit Worker(WorkerOptions options);
  /// Stops with a limit of five seconds unless stopped.
  ~Worker() override;

  /// Returns when the topology runs. The registry and brokers may be away: it works when they come.
  /// \throws config::Error when a component cannot be opened.
  void start() override;
  /// Takes nothing in any more, lets what is under way finish, leaves the registry.
  void stop(std::chrono::milliseconds limit) override;
  std::string trouble() const override;

  /// Before start(): where this worker's pages are, for its record. \param address "127.0.0.1:port"
  void show_http_address(std::string address);

  const std::string& name() const;  ///< unique: below /iot/topologies/<topology>/workers
  Snapshot snapshot() const;        ///< empty before start()

  /// This worker's pages (worker_pages.h), for the daemon to serve. \throws config::Error before start().
  std::string describe() const;
  TapDesk& taps();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::topology
