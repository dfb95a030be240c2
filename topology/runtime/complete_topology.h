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

/// What a component emitted while the topology ran.
struct EmittedTuple {
  std::string component;
  std::string stream;
  int task = 0;
  std::chrono::nanoseconds at{0};  ///< simulated time since the start
  std::vector<Value> values;
};

/// A topology that runs on the caller's thread in simulated time, for tests of users' topologies: put tuples in, let
/// time pass, look at all that was emitted. Nothing sleeps. Not thread safe.
class SimulatedTopology {
 public:
  struct Options {
    /// Spouts (by id) that emit what put() gives them, tracked, instead of running at all. Others run as they are.
    std::set<std::string> inputs;
    std::chrono::milliseconds message_timeout{30000};
    /// Ticks, time-outs and the like happen at multiples of this.
    std::chrono::milliseconds step{1};
  };
  /// Starts it and runs what there is to do at time 0.
  /// \throws TopologyError for an input that names no spout, and what Runtime::start() throws.
  SimulatedTopology(const Topology& topology, Options options);
  ~SimulatedTopology();
  SimulatedTopology(const SimulatedTopology&) = delete;
  SimulatedTopology& operator=(const SimulatedTopology&) = delete;

  /// The spout emits these now, on its default stream; its tasks take turns. Returns when nothing is left to do.
  /// \throws std::invalid_argument when the spout is not among the inputs.
  void put(const std::string& spout, std::vector<Values> tuples);
  void put(const std::string& spout, Values values);
  /// Lets time pass, and what it brings happen.
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

/// A tuple that a spout emits at a time of its own.
struct TimedInput {
  std::chrono::nanoseconds at{0};  ///< simulated time since the start
  Values values;
};

struct CompleteOptions {
  /// Spouts (by id) that emit these tuples on their default stream, tracked, instead of running at all. With several
  /// tasks they take turns.
  std::map<std::string, std::vector<Values>> inputs;
  /// As `inputs`, at the given times; a spout may have both. In any order; those of the same time in the given one.
  std::map<std::string, std::vector<TimedInput>> timed_inputs;
  /// Simulated time to pass after the input is used up, in steps of `step`: ticks and time-outs happen.
  std::chrono::milliseconds run_for{0};
  std::chrono::milliseconds step{1};
  std::chrono::milliseconds message_timeout{30000};
};

struct CompletedTopology {
  std::vector<EmittedTuple> emitted;  ///< by all components to all streams, in order
  Snapshot snapshot;                  ///< counts of the end, before it was stopped

  /// The values that a component emitted to a stream, in order.
  std::vector<std::vector<Value>> tuples(const std::string& component,
                                         const std::string& stream = default_stream) const;
};

/// Runs a topology on fixed input until nothing is left to do, as a SimulatedTopology, and collects all that was
/// emitted. \throws as SimulatedTopology does.
CompletedTopology complete_topology(const Topology& topology, const CompleteOptions& options);

}  // namespace iotcloud::topology
