#pragma once

#include <atomic>
#include <chrono>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology {

/// A clock whose time passes only in advance(). Thread safe.
class SimulatedClock final : public config::Clock {
 public:
  /// The first answer is 2020-01-01 00:00:00 UTC.
  Instant now() const override { return Instant(std::chrono::nanoseconds(ns_.load())); }
  std::int64_t wall_ms() const override { return ns_.load() / 1'000'000; }
  void advance(std::chrono::nanoseconds by) { ns_.fetch_add(by.count()); }

 private:
  std::atomic<std::int64_t> ns_{1'577'836'800'000'000'000};
};

/// A tuple that a component emitted while the topology ran.
struct EmittedTuple {
  std::string component;
  std::string stream;
  int task = 0;
  std::chrono::nanoseconds at{0};  ///< simulated time since the start
  std::vector<Value> values;
};

/// Runs a topology on the caller's thread in simulated time, for tests of users' topologies: a test puts tuples in,
/// lets time pass, and looks at all that was emitted. Nothing sleeps. Not thread safe.
class SimulatedTopology {
 public:
  struct Options {
    /// Ids of spouts that are replaced: they emit, tracked, what put() gives them. All other spouts run unchanged.
    std::set<std::string> inputs;
    std::chrono::milliseconds message_timeout{30000};
    /// Simulated time stops at multiples of this, where ticks, time-outs and polls that are due happen.
    std::chrono::milliseconds step{1};
  };
  /// Starts the topology and runs its tasks at time 0 until none has work.
  /// \throws TopologyError for an input that names no spout, and what Runtime::start() throws.
  SimulatedTopology(const Topology& topology, Options options);
  ~SimulatedTopology();
  SimulatedTopology(const SimulatedTopology&) = delete;
  SimulatedTopology& operator=(const SimulatedTopology&) = delete;

  /// Makes the spout emit these tuples now, on its default stream; its tasks take turns. Returns when no task has work.
  /// \throws std::invalid_argument when the spout is not among the inputs.
  void put(const std::string& spout, std::vector<Values> tuples);
  void put(const std::string& spout, Values values);
  /// Lets `time` pass in steps, and after each runs what became due.
  void advance(std::chrono::nanoseconds time);

  std::chrono::nanoseconds time() const;             ///< since the start
  const std::vector<EmittedTuple>& emitted() const;  ///< by all components to all streams, in order
  /// The values that a component emitted to a stream, in order.
  std::vector<std::vector<Value>> tuples(const std::string& component,
                                         const std::string& stream = default_stream) const;
  Snapshot snapshot() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// A tuple, and when a spout emits it.
struct TimedInput {
  std::chrono::nanoseconds at{0};  ///< simulated time since the start
  Values values;
};

/// The tuples that complete_topology() puts in, and how long it runs.
struct CompleteOptions {
  /// By id of a spout, which is replaced: the tuples that it emits at the start, tracked, on its default stream. Its
  /// tasks take turns.
  std::map<std::string, std::vector<Values>> inputs;
  /// As `inputs`, but each tuple at its time; a spout may have both. The tuples may stand in any order; those of the
  /// same time are emitted in the order in which they stand.
  std::map<std::string, std::vector<TimedInput>> timed_inputs;
  /// How much simulated time passes after the last input, in steps of `step`, so that ticks and time-outs happen.
  std::chrono::milliseconds run_for{0};
  std::chrono::milliseconds step{1};
  std::chrono::milliseconds message_timeout{30000};
};

/// The result of complete_topology().
struct CompletedTopology {
  std::vector<EmittedTuple> emitted;  ///< by all components to all streams, in order
  Snapshot snapshot;                  ///< taken at the end, before the topology was stopped

  /// The values that a component emitted to a stream, in order.
  std::vector<std::vector<Value>> tuples(const std::string& component,
                                         const std::string& stream = default_stream) const;
};

/// Runs a topology as a SimulatedTopology on fixed input until no task has work, and collects all that was emitted.
/// \throws what SimulatedTopology throws.
CompletedTopology complete_topology(const Topology& topology, const CompleteOptions& options);

}  // namespace iotcloud::topology
