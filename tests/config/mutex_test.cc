#include <atomic>
#include <chrono>
#include <concepts>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::config {
namespace {

using std::chrono::hours;
using std::chrono::milliseconds;

template <typename Time>
concept can_be_waited_for = requires(ConditionVariable& changed, StoppableConditionVariable& stoppable, Mutex& mutex,
                                     Time time) {
  changed.wait_until(mutex, time);
};
static_assert(can_be_waited_for<std::chrono::steady_clock::time_point>);
static_assert(!can_be_waited_for<std::chrono::system_clock::time_point>, "the wall clock is not for waits");

struct Guarded {
  Mutex mutex;
  ConditionVariable changed;
  StoppableConditionVariable stoppable;
  int value IOTCLOUD_GUARDED_BY(mutex) = 0;
};

/// Whether another thread could take the mutex now.
bool is_free(Mutex& mutex) {
  bool free = false;
  std::jthread([&] {
    if (mutex.try_lock()) {
      free = true;
      mutex.unlock();
    }
  }).join();
  return free;
}

TEST(Mutex, is_held_by_one_at_a_time) {
  Guarded guarded;
  {
    std::vector<std::jthread> threads;
    threads.reserve(4);
    for (int t = 0; t < 4; ++t) {
      threads.emplace_back([&] {
        for (int i = 0; i < 1000; ++i) {
          const MutexLock lock(guarded.mutex);
          ++guarded.value;
        }
      });
    }
  }
  const MutexLock lock(guarded.mutex);
  EXPECT_EQ(guarded.value, 4000);
}

TEST(UniqueLock, is_given_back_and_taken_again) {
  Guarded guarded;
  UniqueLock lock(guarded.mutex);
  EXPECT_FALSE(is_free(guarded.mutex));
  lock.unlock();
  EXPECT_FALSE(lock.owns_lock());
  EXPECT_TRUE(is_free(guarded.mutex));
  lock.lock();
  EXPECT_TRUE(lock.owns_lock());
  EXPECT_FALSE(is_free(guarded.mutex));
}

TEST(Unlocked, takes_the_mutex_again_when_an_exception_passes) {
  Guarded guarded;
  const MutexLock lock(guarded.mutex);
  try {
    const Unlocked unlocked(guarded.mutex);
    EXPECT_TRUE(is_free(guarded.mutex));
    throw std::runtime_error("foreign code");
  } catch (const std::runtime_error&) {
  }
  EXPECT_FALSE(is_free(guarded.mutex));
}

TEST(SharedMutex, has_many_readers_or_one_writer) {
  SharedMutex mutex;
  std::atomic<int> readers{0}, writers{0};
  const auto read = [&] {
    const ReadLock lock(mutex);
    ++readers;
    EXPECT_TRUE(tests::eventually([&] { return readers == 2; }));
    EXPECT_EQ(writers, 0);
  };
  std::jthread one(read), other(read);
  one.join();
  other.join();
  const WriteLock lock(mutex);
  ++writers;
}

TEST(ConditionVariable, ends_when_its_limit_has_passed) {
  Guarded guarded;
  const MutexLock lock(guarded.mutex);
  const auto filled = [&]() IOTCLOUD_REQUIRES(guarded.mutex) { return guarded.value > 0; };
  const auto began = std::chrono::steady_clock::now();
  EXPECT_FALSE(guarded.changed.wait_for(guarded.mutex, milliseconds(5), filled));
  EXPECT_GE(std::chrono::steady_clock::now() - began, milliseconds(5));
  EXPECT_EQ(guarded.changed.wait_until(guarded.mutex, began), std::cv_status::timeout);
  EXPECT_FALSE(is_free(guarded.mutex));
}

TEST(ConditionVariable, wakes_for_what_it_waits_for_however_long_it_may) {
  Guarded guarded;
  std::jthread thread([&] {
    const MutexLock lock(guarded.mutex);
    guarded.value = 1;
    guarded.changed.notify_all();
  });
  const MutexLock lock(guarded.mutex);
  const auto filled = [&]() IOTCLOUD_REQUIRES(guarded.mutex) { return guarded.value > 0; };
  EXPECT_TRUE(guarded.changed.wait_for(guarded.mutex, milliseconds::max(), filled));
}

TEST(StoppableConditionVariable, ends_when_it_is_told_to_stop) {
  Guarded guarded;
  std::jthread thread([&](const std::stop_token& stop) {
    const MutexLock lock(guarded.mutex);
    const auto filled = [&]() IOTCLOUD_REQUIRES(guarded.mutex) { return guarded.value > 0; };
    EXPECT_FALSE(guarded.stoppable.wait(guarded.mutex, stop, filled));
    EXPECT_FALSE(guarded.stoppable.wait_for(guarded.mutex, stop, hours(1), filled));
  });
  thread.request_stop();
  thread.join();
}

TEST(StoppableConditionVariable, ends_when_its_limit_has_passed) {
  Guarded guarded;
  const MutexLock lock(guarded.mutex);
  const auto never = [] { return false; };
  const auto began = std::chrono::steady_clock::now();
  EXPECT_FALSE(guarded.stoppable.wait_for(guarded.mutex, std::stop_token(), milliseconds(5), never));
  EXPECT_GE(std::chrono::steady_clock::now() - began, milliseconds(5));
}

/// Waits on a clock and reports the result.
class Waiter {
 public:
  Waiter(const Clock& clock, Clock::Instant end)
      : thread_([this, &clock, end] {
          const MutexLock lock(mutex_);
          const auto told = [this]() IOTCLOUD_REQUIRES(mutex_) { return told_; };
          was_told_ = changed_.wait_until(mutex_, clock, end, told);
        }) {}
  void tell() {
    const MutexLock lock(mutex_);
    told_ = true;
    changed_.notify_all();
  }
  bool was_told() {
    thread_.join();
    return was_told_;
  }

 private:
  Mutex mutex_;
  ConditionVariable changed_;
  bool told_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::atomic<bool> was_told_{false};
  std::jthread thread_;
};

TEST(AWaitOnAClock, ends_when_the_clock_has_been_moved_so_far) {
  tests::HandClock clock;
  Waiter soon(clock, clock.now() + hours(1)), late(clock, clock.now() + hours(2));
  ASSERT_TRUE(tests::eventually([&] { return clock.waiting() == 2; }));
  clock.advance(hours(1));
  EXPECT_FALSE(soon.was_told());
  EXPECT_EQ(clock.waiting(), 1U);
  clock.advance(hours(1));
  EXPECT_FALSE(late.was_told());
}

TEST(AWaitOnAClock, ends_when_it_is_told_to) {
  tests::HandClock clock;
  Waiter waiter(clock, clock.now() + hours(1));
  waiter.tell();
  EXPECT_TRUE(waiter.was_told());
  EXPECT_EQ(clock.waiting(), 0U);
}

TEST(AWaitOnAClock, misses_no_move_however_they_meet) {
  tests::HandClock clock;
  for (int i = 0; i < 500; ++i) {
    Waiter one(clock, clock.now() + milliseconds(1)), other(clock, clock.now() + milliseconds(1));
    if (i % 2 == 0) other.tell();
    clock.advance(milliseconds(1));
    EXPECT_FALSE(one.was_told());
  }
}

/// Like the clocks of older tests, which do not know about waits.
class StillClock final : public Clock {
 public:
  Instant now() const override { return now_; }
  std::int64_t wall_ms() const override { return 0; }
  std::atomic<Instant> now_{Instant(hours(1))};
};

TEST(AWaitOnAClock, that_knows_nothing_of_waits_lasts_as_long_on_the_steady_clock) {
  StillClock clock;
  Guarded guarded;
  const MutexLock lock(guarded.mutex);
  const auto began = std::chrono::steady_clock::now();
  EXPECT_EQ(guarded.changed.wait_until(guarded.mutex, clock, clock.now() + milliseconds(5)), std::cv_status::no_timeout)
      << "on this clock no time has passed";
  EXPECT_GE(std::chrono::steady_clock::now() - began, milliseconds(5));
  EXPECT_EQ(guarded.changed.wait_until(guarded.mutex, clock, clock.now()), std::cv_status::timeout);
}

}  // namespace
}  // namespace iotcloud::config
