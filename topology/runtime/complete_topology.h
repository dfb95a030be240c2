#pragma once

#include <atomic>
#include <chrono>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology {

/// Time that passes only when told to. Thread safe.
class SimulatedClock final : public config::Clock {
 public:
  /// Begins at 2020-01-01 00:00:00 UTC.
  Instant now() const override { return Instant(std::chrono::nanoseconds(ns_.load())); }
  std::int64_t wall_ms() const override { return ns_.load() / 1'000'000; }
  void advance(std::chrono::nanoseconds by) { ns_.fetch_add(by.count()); }

 private:
  std::atomic<std::int64_t> ns_{1'577'836'800'000'000'000};
};

/// What a component emitted while the topology ran to completion.
struct EmittedTuple {
  std::string component;
  std::string stream;
  int task = 0;
  std::vector<Value> values;
};

struct CompleteOptions {
  /// Spouts (by id) that emit these tuples on their default stream, tracked, instead of running at all. With several
  /// tasks they take turns.
  std::map<std::string, std::vector<Values>> inputs;
  /// Simulated time to pass after the input is used up, in steps of `step`: ticks and time-outs happen.
  std::chrono::milliseconds run_for{0};
  std::chrono::milliseconds step{1};
  std::chrono::milliseconds message_timeout{30000};
};

struct CompletedTopology {
  std::vector<EmittedTuple> emitted;  ///< of all components, in order; direct streams are not seen
  Snapshot snapshot;                  ///< counts of the end, before it was stopped

  /// The values that a component emitted to a stream, in order.
  std::vector<std::vector<Value>> tuples(const std::string& component,
                                         const std::string& stream = default_stream) const;
};

/// Runs a topology on fixed input until nothing is left to do, on this thread and in simulated time, and collects all
/// that was emitted: for tests of users' topologies. Nothing sleeps. Spouts that are not in `inputs` run as they are.
/// \throws TopologyError for an input that names no spout, and what Runtime::start() throws.
CompletedTopology complete_topology(const Topology& topology, const CompleteOptions& options);

}  // namespace iotcloud::topology
