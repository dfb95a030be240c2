#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

struct RuntimeOptions {
  /// The machine's cores.
  static unsigned default_threads();
  /// Threads of the pool. 0: none; tasks run only on threads that call SpoutWaker::wake() or run_until_idle().
  unsigned threads = default_threads();

  /// nullptr: the system's. With another clock nothing happens by itself when time passes: call run_due_timers().
  const config::Clock* clock = nullptr;
  config::Metrics* metrics = nullptr;  ///< nullptr: the process's

  /// A tracked tuple's tree fails when it is not done between this and 9/8 of it.
  std::chrono::milliseconds message_timeout{30000};
  /// Tracked tuples under way for each spout task. 0 = no limit.
  std::size_t max_spout_pending = 0;
  /// False: Storm's "0 ackers": every tracked tuple counts as acked when it is emitted.
  bool acking = true;
  /// Tuples know when their spout emitted what they come from, as they do where a component has a deadline.
  bool births = false;
  /// Tuples that may wait for one task. Who feeds a task that has so many is not run until half of them are gone; the
  /// queue goes beyond it by what one call of each of its emitters emits at most.
  std::size_t mailbox_capacity = 1024;
  /// Work done on a thread that called wake() before the rest goes to the pool.
  std::chrono::microseconds caller_slice{1000};
  /// Tasks that wait for a thread go to the pool when it stays so long in one task. The time is looked at once a
  /// millisecond.
  std::chrono::microseconds long_slice{900};
  /// User code that does not return for so long is reported as an error of its task. 0 = never.
  std::chrono::milliseconds hang_after{10000};
  /// Called once for each error of user code, from any thread; may be empty. Logged and counted in any case.
  std::function<void(const std::string& component, int task, const std::string& text)> on_error;
};

/// What one task has done so far, and how it is.
struct TaskSnapshot {
  std::string component;
  int task_id = 0;
  bool spout = false;
  std::uint64_t emitted = 0;      ///< tuples handed to emit
  std::uint64_t transferred = 0;  ///< copies of them sent to tasks
  std::uint64_t executed = 0;     ///< bolts: tuples worked on. Spouts: calls of next_tuple that answered true
  std::uint64_t acked = 0;        ///< bolts: inputs acked. Spouts: trees done
  std::uint64_t failed = 0;       ///< bolts: inputs failed. Spouts: trees failed, time-outs included
  std::uint64_t timed_out = 0;    ///< spouts
  std::uint64_t errors = 0;       ///< exceptions and reported errors
  std::uint64_t late = 0;         ///< bolts: tuples older than their deadline, not executed
  std::uint64_t superseded = 0;   ///< bolts: tuples that a newer one replaced while they waited (keep_last)
  std::size_t queue_depth = 0;    ///< tuples that wait
  std::size_t pending = 0;        ///< spouts: trees under way
  std::string last_error;
  double busy_seconds = 0;  ///< time in user code
  double capacity = 0;      ///< part of the last seconds that it was busy, 0 to 1 (components: the busiest task)
  config::Histogram::Summary execute_latency;   ///< bolts: one execute()
  config::Histogram::Summary process_latency;   ///< bolts: from execute() to ack or fail
  config::Histogram::Summary complete_latency;  ///< spouts: from emit to ack
};

struct Snapshot {
  std::string topology;
  bool active = false;
  std::map<std::string, int> parallelism;  ///< of every component, as it is now
  std::vector<TaskSnapshot> tasks;
  /// The tasks of one component added up (latencies: those of the task with the most samples; task_id 0).
  TaskSnapshot component(const std::string& id) const;
};

/// Watches the tuples of a component until destroyed, see Runtime::tap(). When the destructor returns the call does not
/// run any more; so do not destroy it from the call. It may outlive the runtime.
class Tap {
 public:
  virtual ~Tap() = default;
};
/// \param task the task that emits it, or, for a component that emits nothing, executes it.
using TapCall = std::function<void(const Tuple& tuple, int task)>;

/// Runs one topology in this process. Thread safe unless said otherwise.
/// A task is a serial mailbox: its calls never overlap. The thread that wakes a spout runs the tasks that follow too,
/// as long as they are idle and time is not up; the pool does the rest. Nothing spins.
class Runtime {
 public:
  /// Makes the tasks, starts nothing. `clock` and `metrics` of the options must outlive it.
  /// \throws TopologyError when a component or a grouping throws as it is made.
  Runtime(Topology topology, RuntimeOptions options);
  /// stop() without waiting for what is under way. Returns when no user code runs any more.
  ~Runtime();
  Runtime(const Runtime&) = delete;
  Runtime& operator=(const Runtime&) = delete;

  /// Prepares bolts and opens spouts on this thread, then lets them run (spouts are activated first); once.
  /// \throws TopologyError when a component throws in prepare() or open(): those already opened are closed again.
  void start();
  /// Stops asking spouts (deactivates them), waits until what is under way is done, then closes and cleans up.
  /// \return false when `limit` passed first: what was left is in the snapshot; a task that hangs in user code is
  /// cleaned up by the destructor. Once; later calls answer the same.
  bool stop(std::chrono::milliseconds limit);

  /// Pause and go on: spouts are not asked while deactivated; what is under way goes on.
  void deactivate();
  void activate();

  /// Changes how many of a component's tasks may run at the same time, 1 to all of them. Takes effect when the slices
  /// that run end; nothing is lost and no key's tuples change their order.
  /// \throws std::invalid_argument naming what is possible.
  void rebalance(const std::string& component, int parallelism);
  /// Shows a sample of the tuples that a component emits, or, when it emits none, executes.
  /// \param per_second for each task at most; infinity: every one.
  /// \param call on the runtime's threads, one call at a time; keep it short. When it throws it is not called again.
  /// \throws std::invalid_argument when there is no such component.
  std::unique_ptr<Tap> tap(const std::string& component, double per_second, TapCall call);

  Snapshot snapshot() const;
  const Topology& topology() const;

  /// Runs tasks on this thread until none has work. For topologies without threads, and tests.
  void run_until_idle();
  /// Does what is due by the clock (time-outs, ticks, polls). Only with an injected clock; the tasks it makes ready run
  /// on the pool, or in run_until_idle().
  void run_due_timers();
  /// Whether no task has work or is running, right now.
  bool idle() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::topology
