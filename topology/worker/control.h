#pragma once

#include <condition_variable>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/endpoints/services.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology {

/// One worker's place in the registry: shows that it lives and what it does, and makes what is ordered there
/// (discovery::TopologyOrder) so. Thread safe.
class WorkerControl {
 public:
  struct Options {
    EndpointServicesPtr services;        ///< its `before_stop` is called before a drain
    Runtime* runtime = nullptr;          ///< started, and deactivated until the first order, or none, is seen
    discovery::TopologyRecord topology;  ///< what the first worker writes
    discovery::WorkerRecord worker;      ///< name, host, pid, http and since_ms; the rest is filled in here
    /// On a thread of its own, once, after a kill's drain: the worker is to end, and to call leave().
    std::function<void()> on_killed;
    /// How long spouts wait at the start for a registry that does not answer.
    std::chrono::milliseconds patience{2000};
  };
  explicit WorkerControl(Options options);
  /// Shows the worker and begins to follow; once.
  void start();
  /// Waits for a drain no longer; leaves the registry.
  ~WorkerControl();

  /// Follows orders no longer, cuts a drain short. Not from on_killed.
  void end();
  /// Takes the worker out of the registry; the last one takes the topology's records away, but for what is ordered.
  void leave();
  discovery::WorkerRecord record() const;

 private:
  void on_order(const std::optional<discovery::Node>& node);
  void run(const std::stop_token& stop);
  void follow(const std::optional<discovery::Node>& node, const std::stop_token& stop);
  void follow(const discovery::TopologyOrder& order);
  void be_killed(const discovery::TopologyOrder& order, const std::stop_token& stop);
  std::string drain(std::chrono::milliseconds limit, const std::stop_token& stop);
  void forget_old_kill(const discovery::TopologyOrder& order, std::int64_t version);
  void show_topology();
  void report();

  const Options options_;
  discovery::Registry& registry_;
  const std::string order_path_;
  const std::map<std::string, int> declared_;  ///< parallelism by component, before any order

  mutable std::mutex mutex_;
  std::condition_variable_any changed_;
  std::optional<std::optional<discovery::Node>> news_;       ///< guarded by mutex_: the order's node, not yet followed
  bool show_due_ = false;                                    ///< guarded by mutex_: the worker's node was made anew
  bool report_due_ = false;                                  ///< guarded by mutex_
  discovery::WorkerRecord record_;                           ///< guarded by mutex_
  std::optional<discovery::TopologyOrder::Kill> killed_by_;  ///< guarded by mutex_

  bool heard_ = false;  ///< of the thread: whether the spouts were let go

  discovery::GuardPtr membership_, orders_, sessions_;
  std::jthread thread_;  ///< last: it uses the others
};

}  // namespace iotcloud::topology
