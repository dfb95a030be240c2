#pragma once

#include <chrono>
#include <functional>
#include <optional>
#include <set>
#include <string>

#include <iotcloud/config/mutex.h>
#include <iotcloud/master/orders/order_desk.h>
#include <iotcloud/master/orders/place_watch.h>
#include <iotcloud/master/orders/submission_orders.h>

namespace iotcloud::master {

/// Topologies that are submitted to pools of workers. Outcomes are by place: the gateway of an outcome is the pool, the
/// instance TOPOLOGY/PLACE. Thread safe.
class Submissions {
 public:
  explicit Submissions(OrderDesk& desk) : desk_(desk) {}

  /// Answers when all workers run, or why not; a topology of which a worker cannot run is taken back. Does not throw.
  OrderResult submit(const SubmitRequest& request);
  /// Gives the workers another version, one after the other. When one does not run, it and all that were updated before
  /// it go back. When this master ends in the middle, the update stops; the same update goes on with it. Does not
  /// throw.
  OrderResult update(const SubmitRequest& request);
  /// Updates to the version before the last update. Does not throw.
  OrderResult roll_back(const RollbackRequest& request);

  /// Whether a topology is submitted and was not killed, or a pool still has a place of it. \throws
  /// discovery::RegistryError
  bool stands(const discovery::TopologyName& topology);
  /// Marks a topology as killed, so that no pool starts a worker of it any more. \return nullopt if it was marked;
  /// OrderRefusal::unknown_topology if it is not submitted. \throws discovery::RegistryError
  std::optional<OrderResult> mark_killed(const discovery::TopologyName& topology, std::chrono::milliseconds drain,
                                         const discovery::Lead& lead);
  /// Waits until no pool has a place of it any more, or says so. \return false if `limit` passed first
  bool await_end(const discovery::TopologyName& topology, std::chrono::milliseconds limit);
  /// Adds to the topology's history what was ordered last, with its outcome. Does not throw.
  void remember(const discovery::TopologyName& topology, const std::string& order, const std::string& outcome);

 private:
  /// Changes a submission; returns why it cannot be changed, or nothing.
  using Alter = std::function<std::optional<OrderResult>(discovery::Submission&)>;
  std::optional<OrderResult> rewrite(const discovery::TopologyName& topology, const discovery::Lead& lead,
                                     const Alter& alter);
  OrderResult submit_checked(const SubmitRequest& request);
  OrderResult change(const discovery::TopologyName& topology, const std::string& what, const WaitLimit& wait,
                     std::chrono::milliseconds settle, const Alter& begin);
  OrderResult go_step_by_step(const discovery::Submission& wanted, const WaitLimit& wait,
                              std::chrono::milliseconds settle);
  OrderResult go_back(const discovery::Submission& failed, const WaitLimit& wait, OrderResult result);
  OrderResult await_running(const discovery::Submission& submission, int from, int to, const WaitLimit& wait);

  OrderDesk& desk_;
  config::Mutex mutex_;
  std::set<discovery::TopologyName> changing_ IOTCLOUD_GUARDED_BY(mutex_);  ///< those of which an update is under way
};

}  // namespace iotcloud::master
