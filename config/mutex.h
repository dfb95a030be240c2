#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <shared_mutex>
#include <stop_token>
#include <utility>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/thread_safety.h>

/// \file
/// Mutexes, locks and condition variables as in the standard library, annotated for clang's analysis
/// (`thread_safety.h`). Changes of the wall clock neither prolong nor shorten their timed waits.
///
/// A timed wait goes by the steady clock or by an injected Clock; there is no overload for the wall clock
/// (`std::chrono::system_clock`), and `tests/house` refuses such waits elsewhere. libstdc++ 12 implements it with
/// `pthread_cond_clockwait(CLOCK_MONOTONIC)`, which glibc has since 2.30 and which GCC 12's thread sanitizer
/// intercepts. With an older glibc libstdc++ turns waits on the steady clock, `wait_for` included, into waits on the
/// wall clock, so `mutex.cc` does not compile there.
///
/// ```
/// class Queue {
///  public:
///   void put(int value) {
///     {
///       const config::MutexLock lock(mutex_);
///       values_.push_back(value);
///     }
///     changed_.notify_one();
///   }
///   std::optional<int> take(config::Clock::Instant deadline) {
///     const config::MutexLock lock(mutex_);
///     const auto filled = [this]() IOTCLOUD_REQUIRES(mutex_) { return !values_.empty(); };
///     if (!changed_.wait_until(mutex_, deadline, filled)) return std::nullopt;
///     return take_first();
///   }
///
///  private:
///   int take_first() IOTCLOUD_REQUIRES(mutex_);
///   config::Mutex mutex_;
///   config::ConditionVariable changed_;
///   std::deque<int> values_ IOTCLOUD_GUARDED_BY(mutex_);
/// };
/// ```
namespace iotcloud::config {

/// std::mutex. Not recursive.
class IOTCLOUD_CAPABILITY("mutex") Mutex {
 public:
  Mutex() = default;
  Mutex(const Mutex&) = delete;
  Mutex& operator=(const Mutex&) = delete;

  void lock() IOTCLOUD_ACQUIRE() { mutex_.lock(); }
  void unlock() IOTCLOUD_RELEASE() { mutex_.unlock(); }
  [[nodiscard]] bool try_lock() IOTCLOUD_TRY_ACQUIRE(true) { return mutex_.try_lock(); }
  /// Tells the analysis that the mutex is held where it cannot see that, as in a lambda that is called by a function
  /// which holds the mutex. Does nothing at run time.
  void assert_held() const IOTCLOUD_ASSERT_CAPABILITY(this) {}

 private:
  friend class ConditionVariable;
  std::mutex mutex_;
};

/// std::lock_guard: holds the mutex from here to the end of the scope.
class IOTCLOUD_SCOPED_CAPABILITY MutexLock {
 public:
  explicit MutexLock(Mutex& mutex) IOTCLOUD_ACQUIRE(mutex) : mutex_(mutex) { mutex_.lock(); }
  ~MutexLock() IOTCLOUD_RELEASE() { mutex_.unlock(); }
  MutexLock(const MutexLock&) = delete;
  MutexLock& operator=(const MutexLock&) = delete;

 private:
  Mutex& mutex_;
};

/// std::unique_lock: as MutexLock, but the scope may unlock and lock the mutex. Do not pass it to other functions,
/// because the analysis cannot follow it there: declare these IOTCLOUD_REQUIRES(mutex), and use Unlocked in them.
class IOTCLOUD_SCOPED_CAPABILITY UniqueLock {
 public:
  explicit UniqueLock(Mutex& mutex) IOTCLOUD_ACQUIRE(mutex) : mutex_(mutex), held_(true) { mutex_.lock(); }
  ~UniqueLock() IOTCLOUD_RELEASE() {
    if (held_) mutex_.unlock();
  }
  UniqueLock(const UniqueLock&) = delete;
  UniqueLock& operator=(const UniqueLock&) = delete;

  void lock() IOTCLOUD_ACQUIRE() {
    mutex_.lock();
    held_ = true;
  }
  void unlock() IOTCLOUD_RELEASE() {
    held_ = false;
    mutex_.unlock();
  }
  bool owns_lock() const { return held_; }

 private:
  Mutex& mutex_;
  bool held_;
};

/// Unlocks a held mutex for the rest of the scope and locks it again at its end, also when an exception leaves the
/// scope. For a function whose caller holds the mutex, and which calls foreign or blocking code.
class IOTCLOUD_SCOPED_CAPABILITY Unlocked {
 public:
  explicit Unlocked(Mutex& mutex) IOTCLOUD_RELEASE(mutex) : mutex_(mutex) { mutex_.unlock(); }
  /// For the analysis, RELEASE reverses what the constructor did: here it locks the mutex again.
  ~Unlocked() IOTCLOUD_RELEASE() { mutex_.lock(); }
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;

 private:
  Mutex& mutex_;
};

/// std::shared_mutex: one writer or many readers.
class IOTCLOUD_CAPABILITY("shared mutex") SharedMutex {
 public:
  SharedMutex() = default;
  SharedMutex(const SharedMutex&) = delete;
  SharedMutex& operator=(const SharedMutex&) = delete;

  void lock() IOTCLOUD_ACQUIRE() { mutex_.lock(); }
  void unlock() IOTCLOUD_RELEASE() { mutex_.unlock(); }
  void lock_shared() IOTCLOUD_ACQUIRE_SHARED() { mutex_.lock_shared(); }
  void unlock_shared() IOTCLOUD_RELEASE_SHARED() { mutex_.unlock_shared(); }
  void assert_held() const IOTCLOUD_ASSERT_CAPABILITY(this) {}
  void assert_shared() const IOTCLOUD_ASSERT_SHARED_CAPABILITY(this) {}

 private:
  std::shared_mutex mutex_;
};

/// Holds a SharedMutex for writing to the end of the scope.
class IOTCLOUD_SCOPED_CAPABILITY WriteLock {
 public:
  explicit WriteLock(SharedMutex& mutex) IOTCLOUD_ACQUIRE(mutex) : mutex_(mutex) { mutex_.lock(); }
  ~WriteLock() IOTCLOUD_RELEASE() { mutex_.unlock(); }
  WriteLock(const WriteLock&) = delete;
  WriteLock& operator=(const WriteLock&) = delete;

 private:
  SharedMutex& mutex_;
};

/// Holds a SharedMutex for reading to the end of the scope.
class IOTCLOUD_SCOPED_CAPABILITY ReadLock {
 public:
  explicit ReadLock(SharedMutex& mutex) IOTCLOUD_ACQUIRE_SHARED(mutex) : mutex_(mutex) { mutex_.lock_shared(); }
  ~ReadLock() IOTCLOUD_RELEASE() { mutex_.unlock_shared(); }
  ReadLock(const ReadLock&) = delete;
  ReadLock& operator=(const ReadLock&) = delete;

 private:
  SharedMutex& mutex_;
};

/// When a wait that may last for `duration` from now ends; Instant::max() when that is beyond what an Instant holds.
template <typename Rep, typename Period>
Clock::Instant from_now(std::chrono::duration<Rep, Period> duration) {
  const Clock::Instant now = std::chrono::steady_clock::now();
  const std::chrono::duration<double> left = Clock::Instant::max() - now;
  if (std::chrono::duration<double>(duration) >= left) return Clock::Instant::max();
  return now + std::chrono::ceil<Clock::Instant::duration>(duration);
}

/// std::condition_variable. Waits take the mutex that the caller holds. Those without a condition may return early
/// ("spuriously"). A condition is called with the mutex held: write it `[this]() IOTCLOUD_REQUIRES(mutex_) { ... }`.
class ConditionVariable {
 public:
  void notify_one() noexcept { condition_.notify_one(); }
  void notify_all() noexcept { condition_.notify_all(); }

  void wait(Mutex& mutex) IOTCLOUD_REQUIRES(mutex) {
    std::unique_lock<std::mutex> held(mutex.mutex_, std::adopt_lock);
    condition_.wait(held);
    static_cast<void>(held.release());
  }
  std::cv_status wait_until(Mutex& mutex, Clock::Instant end) IOTCLOUD_REQUIRES(mutex) {
    std::unique_lock<std::mutex> held(mutex.mutex_, std::adopt_lock);
    const std::cv_status status = condition_.wait_until(held, end);
    static_cast<void>(held.release());
    return status;
  }
  template <typename Rep, typename Period>
  std::cv_status wait_for(Mutex& mutex, std::chrono::duration<Rep, Period> limit) IOTCLOUD_REQUIRES(mutex) {
    return wait_until(mutex, from_now(limit));
  }
  /// Waits until `clock` reaches `end`: in tests, until the test has moved the clock that far.
  std::cv_status wait_until(Mutex& mutex, const Clock& clock, Clock::Instant end) IOTCLOUD_REQUIRES(mutex) {
    return clock.wait_until(*this, mutex, end);
  }

  // No analysis: it cannot see that `mutex` is the one that the condition requires.
  template <typename Condition>
  void wait(Mutex& mutex, Condition condition) IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    while (!condition()) wait(mutex);
  }
  /// \return whether the condition holds at the end.
  template <typename Condition>
  bool wait_until(Mutex& mutex, Clock::Instant end, Condition condition)
      IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    while (!condition()) {
      if (wait_until(mutex, end) == std::cv_status::timeout) return condition();
    }
    return true;
  }
  template <typename Condition>
  bool wait_until(Mutex& mutex, const Clock& clock, Clock::Instant end, Condition condition)
      IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    while (!condition()) {
      if (wait_until(mutex, clock, end) == std::cv_status::timeout) return condition();
    }
    return true;
  }
  template <typename Rep, typename Period, typename Condition>
  bool wait_for(Mutex& mutex, std::chrono::duration<Rep, Period> limit, Condition condition)
      IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    return wait_until(mutex, from_now(limit), std::move(condition));
  }

 private:
  std::condition_variable condition_;
};

/// std::condition_variable_any: waits that a stop token can end too. It has an internal mutex as well, which makes it
/// slower: use it for threads that seldom wake.
class StoppableConditionVariable {
 public:
  void notify_one() noexcept { condition_.notify_one(); }
  void notify_all() noexcept { condition_.notify_all(); }

  void wait(Mutex& mutex) IOTCLOUD_REQUIRES(mutex) { condition_.wait(mutex); }
  template <typename Condition>
  void wait(Mutex& mutex, Condition condition) IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    condition_.wait(mutex, std::move(condition));
  }
  /// \return whether the condition holds at the end; false if a stop ended the wait first.
  template <typename Condition>
  bool wait(Mutex& mutex, std::stop_token stop, Condition condition)
      IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    return condition_.wait(mutex, std::move(stop), std::move(condition));
  }
  template <typename Condition>
  bool wait_until(Mutex& mutex, std::stop_token stop, Clock::Instant end, Condition condition)
      IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    return condition_.wait_until(mutex, std::move(stop), end, std::move(condition));
  }
  template <typename Rep, typename Period, typename Condition>
  bool wait_for(Mutex& mutex, std::stop_token stop, std::chrono::duration<Rep, Period> limit, Condition condition)
      IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    return condition_.wait_until(mutex, std::move(stop), from_now(limit), std::move(condition));
  }
  template <typename Condition>
  bool wait_until(Mutex& mutex, Clock::Instant end, Condition condition)
      IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    return condition_.wait_until(mutex, end, std::move(condition));
  }
  template <typename Rep, typename Period, typename Condition>
  bool wait_for(Mutex& mutex, std::chrono::duration<Rep, Period> limit, Condition condition)
      IOTCLOUD_REQUIRES(mutex) IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS {
    return condition_.wait_until(mutex, from_now(limit), std::move(condition));
  }

 private:
  std::condition_variable_any condition_;
};

}  // namespace iotcloud::config
