#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <thread>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::topology::internal {

class Runnable;
class Scheduler;

/// Signals tasks when their timers are due, and calls Scheduler::offload_stuck_threads() while threads have tasks
/// waiting. It has one thread, which sleeps in the kernel until something is due; add() sets a kernel timer and does
/// not wake it.
class Timers {
 public:
  /// \param clock_is_real false: a simulated clock, so due timers are signalled only when run_due() is called.
  Timers(const config::Clock& clock, bool clock_is_real);
  ~Timers();

  /// Starts the thread. \param watched the scheduler whose offload_stuck_threads() the thread calls.
  /// \param round called on the thread once every `round_period` of real time.
  void start(Scheduler& watched, std::chrono::milliseconds round_period, std::function<void()> round);
  void stop();

  /// Signals `bits` to the task at `due`, and every `period` after it when that is not zero. Thread safe.
  void add(config::Clock::Instant due, Runnable& task, std::uint32_t bits, std::chrono::nanoseconds period = {});
  /// Removes all periodic timers.
  void end_periodic();
  /// Signals the tasks of all timers that are due.
  void run_due();
  /// Has the watched scheduler's offload_stuck_threads() called about a millisecond from now. Cheap when that was asked
  /// for already.
  void watch();

 private:
  struct Timer {
    config::Clock::Instant due;
    Runnable* task;
    std::uint32_t bits;
    std::chrono::nanoseconds period;
    bool operator<(const Timer& other) const { return due > other.due; }  // std::push_heap keeps the earliest on top
  };
  void run();
  void set_alarm(config::Clock::Instant due);

  const config::Clock& clock_;
  const bool clock_is_real_;
  Scheduler* watched_ = nullptr;
  std::function<void()> round_;
  int alarm_fd_ = -1;
  int watch_fd_ = -1;
  int round_fd_ = -1;
  int stop_fd_ = -1;
  std::atomic<bool> watching_{false};
  config::Mutex mutex_;
  std::vector<Timer> heap_ IOTCLOUD_GUARDED_BY(mutex_);
  std::jthread thread_;
};

}  // namespace iotcloud::topology::internal
