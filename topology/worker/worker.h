#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
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

class Arrivals;
class MessageTraces;
class StandstillFence;

/// The topology that a worker runs, and what it uses.
struct WorkerOptions {
  TopologyDefinition definition;
  /// Linked-in components, in addition to those of `topology.library`.
  ComponentRegistry components;
  /// Where to look for component libraries that are not found relative to the YAML file, in this order.
  std::vector<std::string> library_folders;
  /// Where libraries are that `topology.library` names: paths by those names. Others are looked for as above.
  std::map<std::string, std::string> libraries = {};
  /// Overrides the YAML's registry. Must outlive the worker. nullptr: the worker connects by itself.
  discovery::Registry* registry = nullptr;
  const config::Clock* clock = nullptr;  ///< nullptr: the system's
  config::Metrics* metrics = nullptr;    ///< nullptr: the process's
  /// Called once, on a thread of the worker, after an order killed the topology: the worker has drained, stopped and
  /// left the registry, and the process may end. May be empty.
  std::function<void()> on_killed = {};
  /// Called on a thread of the worker whenever its record has come to stand in the registry, where others find it, the
  /// first time perhaps before start() has returned. May be empty; must not block.
  std::function<void()> on_joined = {};
  /// The owner must call its beat(). Null: the worker makes one from its brokers' heartbeats and the system's clock,
  /// and calls beat() itself.
  std::shared_ptr<StandstillFence> fence = {};
  /// How long a spout's reader that moves to another task or worker waits until what it has in hand is settled; the
  /// broker delivers the rest again. nullopt: 2 s.
  std::optional<std::chrono::milliseconds> longest_drain = {};
};

/// A process that runs a topology: reads from and sends to brokers, runs the graph, shares the channels with other
/// workers of the same topology, and follows the registry's orders (control.h). Thread safe.
class Worker final : public config::DaemonService {
 public:
  /// Loads the component libraries and checks the merged graph; connects nowhere.
  /// \throws config::ConfigError, config::Error.
  explicit Worker(WorkerOptions options);
  /// Calls stop() with a limit of five seconds if it was not called.
  ~Worker() override;

  /// Returns when the topology runs. If the registry or brokers are away, the worker begins to read when they are
  /// there. A stop that is asked for while the worker waits to be the topology's only one ends the wait, and then the
  /// topology does not run. \throws config::Error if a component cannot be opened.
  void start(const std::stop_token& stop) override;
  using config::DaemonService::start;
  /// Takes no more messages, waits until the tuples under way are done, and leaves the registry, within `limit`.
  void stop(std::chrono::milliseconds limit) override;
  std::string trouble() const override;
  /// Reads the masters' keys again. \throws config::Error, and then nothing changes.
  void reload() override;

  /// Call it before start(): sets where this worker's pages are reached, for its record.
  /// \param address "host:port" \param tls whether they take TLS and a token, so that other machines reach them
  void show_http_address(std::string address, bool tls);

  const std::string& name() const;  ///< unique: below `/iot/topologies/<topology>/workers`
  Snapshot snapshot() const;        ///< empty before start()
  LongCall longest_call() const;    ///< empty before start()

  /// This worker's pages (pages.h), for the daemon to serve. \throws config::Error before start().
  std::string describe() const;
  TapDesk& taps();
  /// The ways of messages through this worker. \throws config::Error before start().
  MessageTraces& traces();
  /// What is on its way to each spout. \throws config::Error before start().
  const std::map<std::string, std::shared_ptr<const Arrivals>>& arrivals() const;
  const std::string& topology() const;
  const config::Clock& clock() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::topology
