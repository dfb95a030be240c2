#include <utility>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/fence.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};

std::int64_t ns(Fence::Instant instant) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(instant.time_since_epoch()).count();
}

}  // namespace

Fence::Fence(const config::Clock& clock, std::chrono::milliseconds limit)
    : clock_(&clock),
      limit_ns_(std::chrono::duration_cast<std::chrono::nanoseconds>(limit).count()),
      last_beat_ns_(ns(clock.now())) {}

/// Whoever comes first after a stand-still puts the fence up, before anybody can see that the process runs again.
void Fence::check(Instant now) const {
  if (limit_ns_ == 0) return;
  std::int64_t last = last_beat_ns_.load(std::memory_order_acquire);
  if (ns(now) - last <= limit_ns_) return;
  raise();
  if (last_beat_ns_.compare_exchange_strong(last, ns(now), std::memory_order_acq_rel)) {
    logger.warn("this process stood still for {} ms: what it had in hand is dropped, its brokers give it out again",
                (ns(now) - last) / 1'000'000);
  }
}

/// Counts before it takes the time: who saw the old count after it had taken something took it before this time.
void Fence::raise() const {
  count_.fetch_add(1);
  const std::int64_t now_ns = ns(now());
  std::int64_t since = since_ns_.load(std::memory_order_relaxed);
  while (since < now_ns && !since_ns_.compare_exchange_weak(since, now_ns, std::memory_order_acq_rel)) {
  }
}

Fence::Instant Fence::now() const {
  return clock_ != nullptr ? clock_->now() : config::system_clock().now();
}

void Fence::beat() {
  const Instant now = this->now();  // read once: the process may stand still behind any line
  check(now);
  last_beat_ns_.store(ns(now), std::memory_order_release);

  const std::lock_guard lock(mutex_);
  const std::uint64_t count = count_.load(std::memory_order_acquire);
  if (std::exchange(told_, count) == count) return;
  for (const auto& [number, on_put_up] : listeners_) on_put_up();
}

void Fence::put_up() {
  raise();
}

Fence::Instant Fence::since() const {
  if (limit_ns_ > 0) check(now());
  return Instant(std::chrono::duration_cast<Instant::duration>(
      std::chrono::nanoseconds(since_ns_.load(std::memory_order_acquire))));
}

std::uint64_t Fence::count() const {
  if (limit_ns_ > 0) check(now());
  return count_.load();
}

int Fence::listen(std::function<void()> on_put_up) {
  const std::lock_guard lock(mutex_);
  listeners_[++last_listener_] = std::move(on_put_up);
  return last_listener_;
}

void Fence::ignore(int listener) {
  const std::lock_guard lock(mutex_);
  listeners_.erase(listener);
}

}  // namespace iotcloud::topology
