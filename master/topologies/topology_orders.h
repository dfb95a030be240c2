#pragma once

#include <chrono>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// The kinds of orders to a running topology. Numbers are those of TTopologyChange.
enum class TopologyChange { activate, deactivate, rebalance, kill };
std::string to_string(TopologyChange change);

/// An order to one running topology.
struct TopologyRequest {
  discovery::TopologyName topology;
  TopologyChange change = TopologyChange::activate;
  std::map<std::string, int> parallelism;   ///< for `rebalance`: the parallelism in each worker, by component
  std::chrono::milliseconds drain{10'000};  ///< for `kill`: how long workers wait at most for tuples under way
  WaitLimit wait;                           ///< nullopt with `kill`: at least `drain` plus ten seconds
  static constexpr const char* what = "an order to a topology";
  static constexpr auto fields = std::tuple{
      IOTCLOUD_FIELD(topology, required), IOTCLOUD_FIELD(change, required), IOTCLOUD_FIELD(parallelism, usual),
      IOTCLOUD_FIELD_AS(drain, usual, "drain_ms", drainMs), IOTCLOUD_FIELD_AS(wait, rare, "wait_ms", waitMs)};
};

/// The outcome of an order in one worker.
struct WorkerOutcome {
  std::string worker;
  std::string host;
  OrderOutcome outcome = OrderOutcome::unknown;
  std::string reason;  ///< why, for people; may be empty for `done`
  static constexpr const char* what = "an outcome";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(worker, usual), IOTCLOUD_FIELD(host, usual),
                                            IOTCLOUD_FIELD(outcome, usual), IOTCLOUD_FIELD(reason, usual)};
  friend bool operator==(const WorkerOutcome&, const WorkerOutcome&) = default;
};

/// The answer: refused as a whole (nothing was written), or an outcome for each worker that ran.
struct TopologyResult {
  OrderRefusal refusal = OrderRefusal::none;
  std::string text;    ///< why the order was refused, or a remark besides the outcomes
  std::string leader;  ///< host:port of the master that leads, when `not_leading` and known
  std::vector<WorkerOutcome> outcomes;
  static constexpr const char* what = "an answer to an order to a topology";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(refusal, usual), IOTCLOUD_FIELD(text, usual),
                                            IOTCLOUD_FIELD(leader, rare), IOTCLOUD_FIELD(outcomes, usual)};

  /// Not refused, and every outcome is `done`.
  bool all_done() const;
  /// One line for people.
  std::string summary() const;
};

}  // namespace iotcloud::master
