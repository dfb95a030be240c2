#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include <iotcloud/config/clock.h>

namespace iotcloud::topology::internal {

class Scheduler;
class Task;

/// Signals tasks when their time has come, and looks after threads that are long in one task. One thread, asleep in the
/// kernel until something is due; setting a timer does not wake it.
class Timers {
 public:
  /// \param clock_is_real false: time passes only in run_due().
  Timers(const config::Clock& clock, bool clock_is_real);
  ~Timers();

  /// Starts the thread. \param watched whose look() is to be called.
  /// \param round called once every `round_period`, by real time.
  void start(Scheduler& watched, std::chrono::milliseconds round_period, std::function<void()> round);
  void stop();

  /// Sets `bits` of the task at `due`, and every `period` after it when that is not zero. Thread safe.
  void add(config::Clock::Instant due, Task& task, std::uint32_t bits, std::chrono::nanoseconds period = {});
  /// Takes all periodic timers out.
  void end_periodic();
  void run_due();
  /// The watched scheduler's look() is called about a millisecond from now. Cheap when that is so already.
  void watch();

 private:
  struct Timer {
    config::Clock::Instant due;
    Task* task;
    std::uint32_t bits;
    std::chrono::nanoseconds period;
    bool operator<(const Timer& other) const { return due > other.due; }  // a heap with the earliest on top
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
  std::mutex mutex_;
  std::vector<Timer> heap_;  ///< guarded by mutex_
  std::jthread thread_;
};

}  // namespace iotcloud::topology::internal
