#pragma once

#include <chrono>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// What an order asks of a running topology.
enum class TopologyChange { activate, deactivate, rebalance, kill };
std::string to_string(TopologyChange change);

struct TopologyRequest {
  std::string topology;
  TopologyChange change = TopologyChange::activate;
  std::map<std::string, int> parallelism;   ///< rebalance: in each worker, by component
  std::chrono::milliseconds drain{10'000};  ///< kill: what is under way is waited for so long at most
  WaitLimit wait;                           ///< kill: nothing said = `drain` and ten seconds more at least
};

/// What became of an order in one worker.
struct WorkerOutcome {
  std::string worker;
  std::string host;
  Outcome outcome = Outcome::unknown;
  std::string reason;  ///< for people; empty when done and nothing is to be said
  friend bool operator==(const WorkerOutcome&, const WorkerOutcome&) = default;
};

/// The answer: refused as a whole (nothing was written), or an outcome for each worker that ran.
struct TopologyResult {
  Refusal refusal = Refusal::none;
  std::string text;    ///< why it was refused; or what is to be said besides the outcomes
  std::string leader;  ///< host:port of the master that leads, when `not_leading` and known
  std::vector<WorkerOutcome> outcomes;

  /// Not refused, and every outcome is `done`.
  bool all_done() const;
  /// One line for people.
  std::string summary() const;
};

}  // namespace iotcloud::master
