#pragma once

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <list>
#include <mutex>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::tests {

/// A clock that stands still until a test moves it. A wait on it ends as soon as the test has moved the clock to the
/// wait's end; no real time need pass. Thread safe.
class HandClock final : public config::Clock {
 public:
  explicit HandClock(Instant start = Instant(std::chrono::hours(1)), std::int64_t wall_ms = 1'577'836'800'000)
      : now_(start), wall_ms_(wall_ms) {}

  Instant now() const override {
    const std::lock_guard lock(mutex_);
    return now_;
  }
  std::int64_t wall_ms() const override {
    const std::lock_guard lock(mutex_);
    return wall_ms_;
  }
  std::cv_status wait_until(config::ConditionVariable& changed, config::Mutex& mutex, Instant end) const override
      IOTCLOUD_REQUIRES(mutex) {
    std::unique_lock lock(mutex_);
    if (now_ >= end) return std::cv_status::timeout;
    const auto self = waiters_.insert(waiters_.end(), Waiter{&changed, &mutex, end, 0});
    lock.unlock();
    changed.wait(mutex);
    lock.lock();
    if (self->in_use > 0) {  // advance() is about to lock this waiter's mutex
      mutex.unlock();
      changed_.wait(lock, [&] { return self->in_use == 0; });
      waiters_.erase(self);
      const bool over = now_ >= end;
      lock.unlock();
      mutex.lock();
      return over ? std::cv_status::timeout : std::cv_status::no_timeout;
    }
    waiters_.erase(self);
    return now_ >= end ? std::cv_status::timeout : std::cv_status::no_timeout;
  }

  /// Moves both times, and wakes the threads whose waits are over. The caller must not hold a mutex with which a thread
  /// waits on this clock.
  void advance(std::chrono::nanoseconds by) {
    std::unique_lock lock(mutex_);
    now_ += std::chrono::duration_cast<Instant::duration>(by);
    wall_ms_ += std::chrono::duration_cast<std::chrono::milliseconds>(by).count();
    for (auto waiter = waiters_.begin(); waiter != waiters_.end();) {
      if (waiter->end > now_) {
        ++waiter;
        continue;
      }
      ++waiter->in_use;
      lock.unlock();
      // Once this thread has held the mutex, the waiter either sleeps or has woken, so it cannot miss the notification.
      waiter->mutex->lock();
      waiter->mutex->unlock();
      waiter->changed->notify_all();
      lock.lock();
      --waiter->in_use;
      ++waiter;  // before the waiting thread may erase its entry
      changed_.notify_all();
    }
  }
  /// Moves the time of day alone, as an administrator or NTP does.
  void set_wall_ms(std::int64_t wall_ms) {
    const std::lock_guard lock(mutex_);
    wall_ms_ = wall_ms;
  }
  /// How many threads wait on this clock.
  std::size_t waiting() const {
    const std::lock_guard lock(mutex_);
    return waiters_.size();
  }

 private:
  struct Waiter {
    config::ConditionVariable* changed;
    config::Mutex* mutex;
    Instant end;
    int in_use;  ///< advance() calls that use the two pointers
  };
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  mutable std::list<Waiter> waiters_;  ///< guarded by mutex_, as are the next members
  Instant now_;
  std::int64_t wall_ms_;
};

}  // namespace iotcloud::tests
