#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/runtime.h>
#include <iotcloud/topology/runtime/scheduling/runnable.h>
#include <iotcloud/topology/runtime/tasks/emitter.h>
#include <iotcloud/topology/runtime/tasks/taps.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology::internal {

class Scheduler;
class Timers;

/// The objects that the tasks of a runtime share.
struct TaskEnvironment {
  Scheduler* scheduler = nullptr;
  Timers* timers = nullptr;
  const config::Clock* clock = nullptr;
  const RuntimeOptions* options = nullptr;
  bool clock_is_real = true;  ///< the topology's clock is the system's, which real_ns() reads
  /// Tuples record their birth, because a component has a deadline or RuntimeOptions::births is true.
  bool births = false;
  Troubles* troubles = nullptr;  ///< never null in a running task
};

/// Counts of one task. The thread that runs the task writes them, any thread reads them; any thread writes `errors`.
struct TaskCounts {
  std::atomic<std::uint64_t> emitted{0}, transferred{0}, executed{0}, acked{0}, failed{0}, timed_out{0}, errors{0},
      late{0}, busy_ns{0};
};

/// Adds to a count that only one thread at a time writes: cheaper than an atomic addition.
template <typename Count>
[[gnu::always_inline]] inline void bump(std::atomic<Count>& count, std::type_identity_t<Count> n = 1) {
  count.store(count.load(std::memory_order_relaxed) + n, std::memory_order_relaxed);
}

/// A task: one object of user code, whose calls never overlap. It runs in slices, on the thread whose run list it is
/// on.
class Task : public Runnable {
 public:
  /// \param executors those of the task's component.
  Task(const TaskEnvironment& environment, Executors& executors, Role role, TopologyContext context);

  virtual bool is_spout() const = 0;
  virtual std::size_t depth() const = 0;  ///< tuples in the mailbox
  /// Makes the last call to the user's object; later calls do nothing. \pre no thread runs the task.
  virtual void close() = 0;
  virtual void fill(TaskSnapshot& snapshot) const = 0;

  // Signals: any thread sets them, the next slice acts on them.
  static constexpr std::uint32_t tick_due = 1, wheel_due = 2, poll_due = 4, activity_due = 8, failures_due = 16;
  /// Sets signals and schedules the task. The slice acts on them before it takes tuples from the mailbox.
  void signal(std::uint32_t bits) final;
  void hangs(std::int64_t for_ns) final;

  TaskSnapshot snapshot() const;
  /// Counts an error, logs it (at most one in a second for each task) and passes it to on_error. Any thread.
  void report_error(const std::string& text) noexcept;
  /// Appends its metrics. Any thread.
  virtual void collect(std::vector<config::Sample>& samples) const;
  /// Computes TaskSnapshot::capacity: the part of the time since the last call in which the task was busy. Not thread
  /// safe: only the timers' thread calls it.
  void measure_capacity(std::int64_t now_ns);

  const TopologyContext& context() const { return context_; }
  int id() const { return context_.task; }

  // Back pressure: a task is blocked while it waits for full mailboxes; each calls block() and later unblock().
  bool blocked() const { return blocked_on_.load(std::memory_order_acquire) > 0; }
  void block() { blocked_on_.fetch_add(1, std::memory_order_acq_rel); }
  void unblock();  ///< schedules the task when it waits for no other mailbox

  Taps& taps() { return taps_; }
  bool watched() const { return taps_.any(); }
  /// Tells the traces of a tuple that this task emits it.
  void note_emitted(const TupleCell& cell) const;
  Emitter& emitter() { return emitter_; }

 protected:
  /// Runs user code. \return false when it threw; the error is reported then.
  template <typename Call>
  bool guarded(const char* what, Call&& call) noexcept {
    try {
      call();
      return true;
    } catch (const std::exception& e) {
      report_error(std::string(what) + " threw: " + e.what());
    } catch (...) {
      report_error(std::string(what) + " threw something that is no std::exception");
    }
    return false;
  }
  std::uint32_t take_signals() { return signals_.exchange(0, std::memory_order_acq_rel); }

  std::int64_t topology_ns() const { return environment_.clock->now().time_since_epoch().count(); }
  /// Shows a tuple that is being emitted to the taps. \pre Emitter::choose() chose its receivers.
  void offer_emitted(const Values& values, std::int64_t born_ns);
  void add_sample(std::vector<config::Sample>& samples, const char* name, const char* help,
                  const config::Histogram& histogram) const;

  const TaskEnvironment environment_;
  Holdings holdings_;
  const TopologyContext context_;
  Emitter emitter_;
  Taps taps_;
  TaskCounts counts_;
  /// Usual emits (Emitter::usual()) since count_usual() was called last. Used only in the task's own calls.
  std::uint64_t usual_emits_ = 0;
  /// Counts what was emitted since the last call.
  void count_usual() {
    if (usual_emits_ == 0) return;
    bump(counts_.emitted, usual_emits_);
    bump(counts_.transferred, std::exchange(usual_emits_, 0));
  }
  std::size_t chunk_ = 1;  ///< calls of user code between two readings of the clock; next_chunk() adapts it

 private:
  std::atomic<std::uint32_t> signals_{0};
  std::atomic<int> blocked_on_{0};
  std::atomic<double> capacity_{0};
  std::int64_t capacity_since_ns_ = 0;
  std::uint64_t capacity_busy_ns_ = 0;
  mutable config::Mutex error_mutex_;
  std::string last_error_ IOTCLOUD_GUARDED_BY(error_mutex_);
  std::int64_t last_log_ns_ IOTCLOUD_GUARDED_BY(error_mutex_) = 0;
  std::uint64_t unlogged_ IOTCLOUD_GUARDED_BY(error_mutex_) = 0;
};

}  // namespace iotcloud::topology::internal
