#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/security/trusted_keys.h>
#include <iotcloud/topology/endpoints/services.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology {

/// A worker's part in the registry: keeps the record that shows that the worker lives and what it does, and carries out
/// the topology's orders (discovery::TopologyOrder). With the keys of masters it follows only what one of them has
/// signed (security/signed_object.h) for this topology, and no order that was given before the last one, or long before
/// it was written (discovery::Node::modified_ms): a worker that starts does not know which order was the last, but an
/// old one that somebody wrote once more is younger in the registry than its signature says. A refused order changes
/// nothing, is logged, counted (iotcloud_topology_orders_refused_total) and told by the worker's record. Thread safe.
class WorkerControl {
 public:
  struct Options {
    EndpointServicesPtr services;  ///< its `before_stop` is called before a drain
    /// Started and deactivated; this class activates it when it knows the first order, or that there is none.
    Runtime* runtime = nullptr;
    discovery::TopologyRecord topology;  ///< the topology's first worker writes it
    discovery::WorkerRecord worker;      ///< name, host, pid, http and since_ms; this class fills in the rest
    /// Called once, on a thread of its own, after a kill order's drain: the owner must stop the worker and call
    /// leave().
    std::function<void()> on_killed;
    /// Called whenever the worker's record has come to stand in the registry. May be empty; must not block.
    std::function<void()> on_joined{};
    /// How long spouts wait at the start for a registry that does not answer.
    std::chrono::milliseconds patience{2000};
    std::shared_ptr<const security::TrustedKeys> masters{};  ///< null: orders need no signature
  };
  explicit WorkerControl(Options options);
  /// Writes the worker's record and begins to follow orders. Call it once.
  void start();
  /// Cuts a drain short and leaves the registry.
  ~WorkerControl();

  /// Stops following orders and cuts a drain short. Do not call it from on_killed.
  void end();
  /// Removes the worker's record. The last worker also removes the topology's records, except orders.
  void leave();
  discovery::WorkerRecord record() const;
  /// Shows in the worker's record what it cannot do now; empty: nothing is known.
  void show_trouble(const std::string& trouble);

 private:
  void on_order(const std::optional<discovery::Node>& node);
  void run(const std::stop_token& stop);
  void follow(const std::optional<discovery::Node>& node, const std::stop_token& stop);
  void follow(const discovery::TopologyOrder& order);
  void stay(const std::string& why);
  std::string objection(const discovery::Node& node, const discovery::TopologyOrder& order);
  bool written_late(const discovery::Node& node, std::int64_t given_ms);
  void refuse(const std::string& why);
  void await_work(const std::stop_token& stop, std::chrono::steady_clock::time_point patience)
      IOTCLOUD_REQUIRES(mutex_);
  bool has_news() const IOTCLOUD_REQUIRES(mutex_);
  void be_killed(const discovery::TopologyOrder& order, const std::stop_token& stop);
  std::string drain(std::chrono::milliseconds limit, const std::stop_token& stop);
  void forget_old_kill(const discovery::TopologyOrder& order, std::int64_t version);
  void show_topology();
  void report();

  const Options options_;
  discovery::Registry& registry_;
  const std::string order_path_;
  const std::map<std::string, int> declared_;  ///< parallelism by component, without orders

  mutable config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  /// The order's node as it changed last, until it is followed; an empty node: there is no order.
  std::optional<std::optional<discovery::Node>> news_ IOTCLOUD_GUARDED_BY(mutex_);
  bool joined_ IOTCLOUD_GUARDED_BY(mutex_) = false;    ///< the worker's node was made
  bool show_due_ IOTCLOUD_GUARDED_BY(mutex_) = false;  ///< the worker's node must be written again
  bool report_due_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool keys_changed_ IOTCLOUD_GUARDED_BY(mutex_) = false;  ///< other masters' keys are trusted
  discovery::WorkerRecord record_ IOTCLOUD_GUARDED_BY(mutex_);
  std::optional<discovery::TopologyKill> killed_by_ IOTCLOUD_GUARDED_BY(mutex_);

  bool spouts_activated_ = false;           ///< the spouts were activated; only thread_ uses it
  std::optional<discovery::Node> refused_;  ///< the order that stands there, if it is refused; only thread_ uses it
  /// Signed orders that were given before this (wall time) are not followed; only thread_ uses it.
  std::int64_t oldest_ = std::numeric_limits<std::int64_t>::min();

  discovery::GuardPtr membership_, orders_, sessions_;
  std::jthread keys_watch_;  ///< TrustedKeys::on_change()
  std::jthread thread_;      ///< last, because it uses the other members
};

}  // namespace iotcloud::topology
