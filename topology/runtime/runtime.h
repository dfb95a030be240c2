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
#include <iotcloud/topology/runtime/trouble_board.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

/// Threads, limits, clock and metrics of a Runtime.
struct RuntimeOptions {
  /// The number of the machine's hardware threads.
  static unsigned default_threads();
  /// Threads of the pool. 0: no pool; tasks run only on threads that call SpoutWaker::wake() or run_until_idle().
  unsigned threads = default_threads();

  /// The topology's clock; nullptr: the system's. The runtime cannot wait for the time of another clock: its owner
  /// calls run_due_timers() after it set the time.
  const config::Clock* clock = nullptr;
  config::Metrics* metrics = nullptr;  ///< where the tasks' metrics appear; nullptr: the process's
  /// Where components say what hinders them; nullptr: a board of the runtime's own.
  TroubleBoard* troubles = nullptr;

  /// The message time-out T: a tracked tuple's tree that is not done fails between T and 9/8 T after it was emitted.
  std::chrono::milliseconds message_timeout{30000};
  /// How many tracked tuples each spout task may have under way. 0: no limit.
  std::size_t max_spout_pending = 0;
  /// False: nothing is tracked, and a spout's tuple counts as acked when it is emitted (Storm: "0 ackers").
  bool acking = true;
  /// True: every tuple records when its spout emitted the root of its tree (TupleData::born_ns), also in a topology
  /// without deadlines. For this the clock is read before each call of a spout's next_tuple().
  bool births = false;
  /// How many tuples a task's mailbox holds until it is full. A task that emits to a full mailbox does not run again
  /// until the mailbox is half empty. Emitting tasks deliver tuples in batches: each of at most half of the room that
  /// its task saw when the batch began, and what one call emits. So a mailbox may hold more than this while several
  /// tasks fill it.
  std::size_t mailbox_capacity = 1024;
  /// How long a thread that called SpoutWaker::wake() runs tasks before it hands those that are ready to the pool.
  std::chrono::microseconds caller_slice{1000};
  /// When a thread has been in one task for this long, the tasks on its run list move to the pool. The runtime checks
  /// once a millisecond.
  std::chrono::microseconds long_slice{900};
  /// A call of user code that has not returned for this long is reported as an error of its task. 0: never.
  std::chrono::milliseconds hang_after{10000};
  /// Called once for each error of user code, on any thread; may be empty. Errors are logged and counted in any case.
  std::function<void(const std::string& component, int task, const std::string& text)> on_error;
};

/// What was emitted to one of several streams.
struct StreamSnapshot {
  std::string stream;
  std::uint64_t emitted = 0, transferred = 0;  ///< as in TaskSnapshot
};

/// What became of the tuples of one of several inputs of a bolt.
struct InputSnapshot {
  std::string from;  ///< the component that emits them
  std::string stream;
  std::uint64_t executed = 0, acked = 0, failed = 0, late = 0;  ///< as in TaskSnapshot
};

/// Counts of one task since its start, and its present state.
struct TaskSnapshot {
  std::string component;
  int task_id = 0;
  bool spout = false;
  std::uint64_t emitted = 0;            ///< tuples that the component passed to emit
  std::uint64_t transferred = 0;        ///< deliveries of these tuples to tasks
  std::vector<StreamSnapshot> streams;  ///< each stream's part of these; empty: the component has one stream, or none
  std::uint64_t executed = 0;           ///< bolts: tuples executed. Spouts: calls of next_tuple() that returned true
  std::uint64_t acked = 0;              ///< bolts: inputs acked. Spouts: trees acked
  std::uint64_t failed = 0;             ///< bolts: inputs failed. Spouts: trees failed, time-outs included
  std::uint64_t timed_out = 0;          ///< spouts: trees that failed by the message time-out
  std::uint64_t errors = 0;             ///< exceptions of user code, and errors that it reported
  std::uint64_t late = 0;               ///< bolts: tuples older than their deadline, not executed
  std::uint64_t superseded = 0;         ///< bolts: waiting tuples that a newer one replaced (keep_last)
  std::vector<InputSnapshot> inputs;    ///< each input's executed, acked, failed and late; empty: it has one, or none
  std::size_t queue_depth = 0;          ///< bolts: tuples in the mailbox
  std::size_t pending = 0;              ///< spouts: trees under way
  double oldest_seconds = 0;  ///< spouts: since the oldest of them was emitted. Of a component: of all its tasks
  std::string last_error;
  /// What the task keeps (Holdings); of a component: of all its tasks.
  std::int64_t window_tuples = -1, state_entries = -1, state_bytes = -1;
  double busy_seconds = 0;  ///< time in user code
  /// Part of the last seconds in which the task was busy, 0 to 1. Of a component: that of its busiest task.
  double capacity = 0;
  config::Histogram::Summary execute_latency;   ///< bolts: duration of execute()
  config::Histogram::Summary process_latency;   ///< bolts: from the call of execute() to ack or fail
  config::Histogram::Summary complete_latency;  ///< spouts: from emit to the ack of the whole tree
  config::Histogram::Spread execute_spread, process_spread, complete_spread;  ///< of these latencies
};

/// The call of user code that has not returned for longest.
struct LongCall {
  std::string component;  ///< empty: no user code runs
  int task = 0;
  std::chrono::milliseconds age{};  ///< about: since its task's slice began
};

/// The counts of all tasks of a topology so far.
struct Snapshot {
  std::string topology;
  bool active = false;
  std::map<std::string, int> parallelism;  ///< by component, as rebalance() left it
  std::vector<TaskSnapshot> tasks;
  std::vector<TroubleBoard::Trouble> troubles;  ///< what hinders components now, as they say it
  /// Adds up the tasks of one component. The result's task_id is 0, and its latencies are those of the task with the
  /// most samples.
  TaskSnapshot component(const std::string& id) const;
};

/// Shows tuples of a component to a TapCall until it is destroyed (Runtime::tap()). Its destructor waits until the call
/// does not run any more, unless the call itself destroys it. It may outlive the runtime.
class Tap {
 public:
  virtual ~Tap() = default;
};
/// \param task the task that emits the tuple; of a component that emits nothing, the task that executes it.
using TapCall = std::function<void(const Tuple& tuple, int task)>;

/// Runs one topology in this process. Thread safe unless said otherwise.
/// Calls to one task never overlap. The thread that wakes a spout also runs the idle tasks that its tuples reach, for
/// RuntimeOptions::caller_slice at most; the pool runs the rest. No thread spins.
class Runtime {
 public:
  /// Makes the tasks, starts nothing. `clock` and `metrics` of the options must outlive the runtime.
  /// \throws TopologyError when the factory of a component or grouping throws.
  Runtime(Topology topology, RuntimeOptions options);
  /// Stops as stop(0 ms) does, then waits until no user code runs any more.
  ~Runtime();
  Runtime(const Runtime&) = delete;
  Runtime& operator=(const Runtime&) = delete;

  /// Prepares bolts and opens spouts on the calling thread, then lets the tasks run; the first call to a running spout
  /// is activate(). Call it once. \throws TopologyError when a component throws in prepare() or open(), after it closed
  /// those that were opened before.
  void start();
  /// Deactivates the spouts, waits at most `limit` until all trees under way are done and no task has work, then closes
  /// the spouts and cleans up the bolts. \return false when `limit` passed first: snapshot() shows what was left, and
  /// the destructor cleans up tasks that were still in user code. Only the first call stops; later ones return its
  /// answer.
  bool stop(std::chrono::milliseconds limit);

  /// Pauses the spouts: next_tuple() is not called until activate(). Bolts go on with the tuples that are under way.
  void deactivate();
  void activate();

  /// Sets how many of a component's tasks may run at the same time, 1 to all of them. Takes effect as the running
  /// slices end. No tuple is lost, and tuples of one key keep their order. \throws std::invalid_argument, whose text
  /// names what is possible.
  void rebalance(const std::string& component, int parallelism);
  /// Shows a sample of the tuples that a component emits; of a component that declares no stream, those that it
  /// executes. \param per_second how many tuples of each task are shown in a second at most; infinity: all. \param call
  /// runs on the runtime's threads, one call at a time, and holds up the task; keep it short. When it throws, the
  /// runtime logs the error and does not call it again. \throws std::invalid_argument for an unknown component.
  std::unique_ptr<Tap> tap(const std::string& component, double per_second, TapCall call);

  /// While on, the tasks tell traces (TupleOrigin::trace()) of their tuples. Off at first, and then traces cost
  /// nothing.
  void trace(bool on);

  Snapshot snapshot() const;
  const Topology& topology() const;

  /// Runs tasks on the calling thread until none has work. For a runtime without threads, and for tests.
  void run_until_idle();
  /// Makes the tasks ready whose time-outs, ticks and polls are due by the injected clock; they run on the pool, or in
  /// run_until_idle(). With the system's clock the runtime does this by itself.
  void run_due_timers();
  LongCall longest_call() const;
  /// Whether no task has work and none runs at this moment.
  bool idle() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace iotcloud::topology
