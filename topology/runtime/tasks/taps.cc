#include <cmath>

#include <iotcloud/topology/runtime/logger.h>
#include <iotcloud/topology/runtime/tasks/taps.h>

namespace iotcloud::topology::internal {

TapPoint::TapPoint(double per_second, TapCall call)
    : pause_ns_(per_second > 0 && std::isfinite(per_second) ? static_cast<std::int64_t>(1e9 / per_second) : 0),
      call_(std::move(call)) {}

bool TapPoint::claim_sample(std::int64_t now_ns) {
  std::int64_t next = next_ns_.load(std::memory_order_relaxed);
  return now_ns >= next && next_ns_.compare_exchange_strong(next, now_ns + pause_ns_, std::memory_order_relaxed);
}

void TapPoint::sample(const Tuple& tuple, int task) {
  const config::MutexLock lock(mutex_);
  if (ended_.load()) return;
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

void TapPoint::end() {
  const config::MutexLock lock(mutex_);
  ended_.store(true);
}

void Taps::add(std::shared_ptr<TapPoint> point) {
  const config::MutexLock lock(mutex_);
  points_.push_back(std::move(point));
  any_.store(true, std::memory_order_relaxed);
}

std::vector<std::shared_ptr<TapPoint>> Taps::due(std::int64_t now_ns) {
  std::vector<std::shared_ptr<TapPoint>> wanting;
  const config::MutexLock lock(mutex_);
  std::erase_if(points_, [](const auto& point) { return point->ended(); });
  any_.store(!points_.empty(), std::memory_order_relaxed);
  for (const auto& point : points_) {
    if (point->claim_sample(now_ns)) wanting.push_back(point);
  }
  return wanting;
}

}  // namespace iotcloud::topology::internal
