#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <string>
#include <vector>

#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/runtime/runtime.h>
#include <iotcloud/topology/runtime/tasks/emitter.h>
#include <iotcloud/topology/runtime/tasks/taps.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology::internal {

class Executors;
class Lane;
class Scheduler;
class Timers;

/// What the tasks of a runtime share.
struct Surroundings {
  Scheduler* scheduler = nullptr;
  Timers* timers = nullptr;
  const config::Clock* clock = nullptr;
  const RuntimeOptions* options = nullptr;
  bool clock_is_real = true;  ///< the topology's clock is that of real_ns()
  bool has_deadlines =
      false;  ///< somewhere in the topology, or RuntimeOptions::births: tuples must know when they were born
};

/// Counts of one task. Written by the thread that runs it, read by any (errors: written by any).
struct Counts {
  std::atomic<std::uint64_t> emitted{0}, transferred{0}, executed{0}, acked{0}, failed{0}, timed_out{0}, errors{0},
      late{0}, busy_ns{0};
};

inline void bump(std::atomic<std::uint64_t>& count, std::uint64_t n = 1) {
  count.store(count.load(std::memory_order_relaxed) + n, std::memory_order_relaxed);
}

/// A task: one object of user code, its calls serial. It runs in slices, on whatever thread has it on its run list.
class Task {
 public:
  enum class State : std::uint8_t {
    idle,      ///< nothing to do
    queued,    ///< on one run list
    running,   ///< a thread is in it (also before start and after stop: held)
    notified,  ///< running, and there is news since
  };

  Task(const Surroundings& surroundings, TopologyContext context);
  virtual ~Task() = default;
  Task(const Task&) = delete;
  Task& operator=(const Task&) = delete;

  /// Works for a while on the calling thread. \return true when there is more to do.
  virtual bool slice(Lane& lane) = 0;
  virtual bool is_spout() const = 0;
  virtual std::size_t depth() const = 0;  ///< tuples that wait
  /// About how long what it has to do now will take.
  virtual std::int64_t waiting_ns() const = 0;
  /// The end of its life, once; only when nothing else runs it.
  virtual void close() = 0;
  virtual void fill(TaskSnapshot& snapshot) const = 0;

  // Asked for by any thread, done in the next slice.
  static constexpr std::uint32_t tick_due = 1, wheel_due = 2, poll_due = 4, activity_due = 8;
  /// Sets control bits and schedules. These pass whatever waits.
  void signal(std::uint32_t bits);

  TaskSnapshot snapshot() const;
  /// Counts, logs (once a second for a task at most) and hands on. Any thread.
  void report_error(const std::string& text) noexcept;
  /// Appends its metrics. Any thread.
  virtual void collect(std::vector<config::Sample>& samples) const;
  /// Capacity: the part of the time since the last call that it was busy, 0 to 1. One thread.
  void measure_capacity(std::int64_t now_ns);

  const TopologyContext& context() const { return context_; }
  int id() const { return context_.task; }

  // Back pressure: how many full mailboxes this task waits for.
  bool blocked() const { return blocked_on_.load(std::memory_order_acquire) > 0; }
  void block() { blocked_on_.fetch_add(1, std::memory_order_acq_rel); }
  void unblock();  ///< schedules it when nothing is left to wait for

  Taps& taps() { return taps_; }
  Emitter& emitter() { return emitter_; }

  std::atomic<State> state{State::running};
  Task* next_ready = nullptr;      ///< in a run list
  Executors* executors = nullptr;  ///< the component's

 protected:
  /// Runs user code. \return false, with the error reported, when it threw.
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

  std::int64_t topology_ns() const { return around_.clock->now().time_since_epoch().count(); }
  /// Shows what is emitted to those who watch; after Emitter::choose().
  void offer_emitted(const Values& values, std::int64_t born_ns);
  void add_sample(std::vector<config::Sample>& samples, const char* name, const char* help,
                  const config::Histogram& histogram) const;

  const Surroundings around_;
  const TopologyContext context_;
  Emitter emitter_;
  Taps taps_;
  Counts counts_;
  /// One call takes about so long: it falls at once and rises slowly, because a thread that had to wait for a core
  /// looks as if its calls were long.
  std::atomic<std::int64_t> each_ns_{0};
  void note_each(std::int64_t ns) {
    const std::int64_t before = each_ns_.load(std::memory_order_relaxed);
    each_ns_.store(ns <= before ? ns : before + (ns - before + 7) / 8, std::memory_order_relaxed);
  }
  std::size_t chunk_ = 1;  ///< calls between two looks at the clock; grows while they are quick

 private:
  std::atomic<std::uint32_t> signals_{0};
  std::atomic<int> blocked_on_{0};
  std::atomic<double> capacity_{0};
  std::int64_t capacity_since_ns_ = 0;
  std::uint64_t capacity_busy_ns_ = 0;
  mutable std::mutex error_mutex_;
  std::string last_error_;        ///< guarded by error_mutex_
  std::int64_t last_log_ns_ = 0;  ///< guarded by error_mutex_
  std::uint64_t unlogged_ = 0;    ///< guarded by error_mutex_
};

}  // namespace iotcloud::topology::internal
