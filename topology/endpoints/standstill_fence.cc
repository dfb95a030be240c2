#include <exception>
#include <utility>

#include <iotcloud/topology/endpoints/logger.h>
#include <iotcloud/topology/endpoints/standstill_fence.h>

namespace iotcloud::topology {

namespace {

std::int64_t ns(StandstillFence::Instant instant) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(instant.time_since_epoch()).count();
}

}  // namespace

StandstillFence::StandstillFence(const config::Clock& clock, std::chrono::milliseconds limit)
    : clock_(&clock),
      limit_ns_(std::chrono::duration_cast<std::chrono::nanoseconds>(limit).count()),
      last_beat_ns_(ns(clock.now())) {}

/// Puts the fence up after a standstill. Every question about the fence calls this, so the first one after a standstill
/// gets the right answer already.
void StandstillFence::check(Instant now) const {
  if (limit_ns_ == 0) return;
  std::int64_t last = last_beat_ns_.load(std::memory_order_acquire);
  if (ns(now) - last <= limit_ns_) return;
  void_all();
  if (last_beat_ns_.compare_exchange_strong(last, ns(now), std::memory_order_acq_rel)) {
    endpoints_logger.warn(
        "this process stood still for {} ms: it drops the messages that it had in hand, and its brokers deliver them "
        "again",
        (ns(now) - last) / 1'000'000);
  }
}

/// Raises the count before it reads the clock: so a message that was taken while a reader still saw the old count is
/// older than since_ns_.
void StandstillFence::void_all() const {
  count_.fetch_add(1);
  const std::int64_t now_ns = ns(now());
  std::int64_t since = since_ns_.load(std::memory_order_relaxed);
  while (since < now_ns && !since_ns_.compare_exchange_weak(since, now_ns, std::memory_order_acq_rel)) {
  }
}

StandstillFence::Instant StandstillFence::now() const {
  return clock_ != nullptr ? clock_->now() : config::system_clock().now();
}

void StandstillFence::beat() {
  const Instant now = this->now();  // read once, because the process may stand still between any two lines
  check(now);
  last_beat_ns_.store(ns(now), std::memory_order_release);

  const config::MutexLock lock(mutex_);
  if (teller_ != std::thread::id())
    return;  // another beat() tells the listeners, and checks the count again when it has told them
  teller_ = std::this_thread::get_id();
  try {
    while (told_ != count_.load(std::memory_order_acquire)) tell_listeners();
  } catch (...) {
    teller_ = {};
    throw;
  }
  teller_ = {};
}

void StandstillFence::tell_listeners() {
  told_ = count_.load(std::memory_order_acquire);
  const int last = last_listener_;  // a listener that is added meanwhile is not told of what was before
  for (auto next = listeners_.begin(); next != listeners_.end() && next->first <= last;) {
    const int listener = next->first;
    call(listener);
    next = listeners_.upper_bound(listener);
  }
}

void StandstillFence::call(int listener) {
  called_ = listener;
  std::function<void()> on_raised = listeners_.at(listener);  // a copy: ignore() may remove it meanwhile
  std::exception_ptr failure;
  {
    const config::Unlocked unlocked(mutex_);
    try {
      on_raised();
    } catch (...) {
      failure = std::current_exception();
    }
    on_raised = nullptr;  // what the function owns is destroyed before ignore() returns
  }
  called_ = 0;
  left_.notify_all();
  if (failure) std::rethrow_exception(failure);
}

void StandstillFence::raise() {
  void_all();
}

StandstillFence::Instant StandstillFence::since() const {
  if (limit_ns_ > 0) check(now());
  return Instant(std::chrono::duration_cast<Instant::duration>(
      std::chrono::nanoseconds(since_ns_.load(std::memory_order_acquire))));
}

std::uint64_t StandstillFence::count() const {
  if (limit_ns_ > 0) check(now());
  return count_.load();
}

int StandstillFence::listen(std::function<void()> on_raised) {
  const config::MutexLock lock(mutex_);
  listeners_[++last_listener_] = std::move(on_raised);
  return last_listener_;
}

void StandstillFence::ignore(int listener) {
  const config::MutexLock lock(mutex_);
  listeners_.erase(listener);
  if (teller_ == std::this_thread::get_id()) return;
  while (called_ == listener) left_.wait(mutex_);
}

FenceHeart::FenceHeart(StandstillFence& fence, std::chrono::milliseconds limit)
    : thread_([&fence, limit](const std::stop_token& stop) {
        config::Mutex mutex;
        config::StoppableConditionVariable end;
        const config::MutexLock lock(mutex);
        do {
          fence.beat();
        } while (!end.wait_for(mutex, stop, limit / 4, [&] { return stop.stop_requested(); }));
      }) {}

}  // namespace iotcloud::topology
