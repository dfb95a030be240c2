#include <cmath>

#include <iotcloud/topology/runtime/logger.h>
#include <iotcloud/topology/runtime/tasks/taps.h>

namespace iotcloud::topology::internal {

void TapWatcher::show(const Tuple& tuple, int task) {
  {
    const config::MutexLock lock(mutex_);
    if (running_ == std::this_thread::get_id()) return;  // the call itself makes the runtime run tasks
    left_.wait(mutex_, [this]() IOTCLOUD_REQUIRES(mutex_) { return running_ == std::thread::id(); });
    if (ended_.load()) return;
    running_ = std::this_thread::get_id();
  }
  run(tuple, task);
  const config::MutexLock lock(mutex_);
  running_ = std::thread::id();
  left_.notify_all();
}

void TapWatcher::run(const Tuple& tuple, int task) {
  try {
    call_(tuple, task);
  } catch (const std::exception& error) {
    ended_.store(true);
    logger.error("the tap on task {} threw and is removed: {}", task, error.what());
  } catch (...) {
    ended_.store(true);
    logger.error("the tap on task {} threw no std::exception and is removed", task);
  }
}

void TapWatcher::end() {
  const config::MutexLock lock(mutex_);
  ended_.store(true);
  if (running_ == std::this_thread::get_id()) return;
  left_.wait(mutex_, [this]() IOTCLOUD_REQUIRES(mutex_) { return running_ == std::thread::id(); });
}

TapPoint::TapPoint(double per_second, std::shared_ptr<TapWatcher> watcher)
    : pause_ns_(per_second > 0 && std::isfinite(per_second) ? static_cast<std::int64_t>(1e9 / per_second) : 0),
      watcher_(std::move(watcher)) {}

bool TapPoint::claim_sample(std::int64_t now_ns) {
  std::int64_t next = next_ns_.load(std::memory_order_relaxed);
  return now_ns >= next && next_ns_.compare_exchange_strong(next, now_ns + pause_ns_, std::memory_order_relaxed);
}

void Taps::add(std::shared_ptr<TapPoint> point) {
  const config::MutexLock lock(mutex_);
  points_.push_back(std::move(point));
  any_.store(true, std::memory_order_relaxed);
}

void Taps::trace(bool on) {
  const config::MutexLock lock(mutex_);
  traces_ = on;
  any_.store(traces_ || !points_.empty(), std::memory_order_relaxed);
}

std::vector<std::shared_ptr<TapPoint>> Taps::due(std::int64_t now_ns) {
  std::vector<std::shared_ptr<TapPoint>> wanting;
  const config::MutexLock lock(mutex_);
  std::erase_if(points_, [](const auto& point) { return point->watcher().ended(); });
  any_.store(traces_ || !points_.empty(), std::memory_order_relaxed);
  for (const auto& point : points_) {
    if (point->claim_sample(now_ns)) wanting.push_back(point);
  }
  return wanting;
}

}  // namespace iotcloud::topology::internal
