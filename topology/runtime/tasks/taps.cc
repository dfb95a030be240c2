#include <cmath>

#include <iotcloud/config/log.h>
#include <iotcloud/topology/runtime/tasks/taps.h>

namespace iotcloud::topology::internal {

namespace {
constexpr config::Logger logger{"topology"};
}

TapPoint::TapPoint(double per_second, TapCall call)
    : pause_ns_(per_second > 0 && std::isfinite(per_second) ? static_cast<std::int64_t>(1e9 / per_second) : 0),
      call_(std::move(call)) {}

bool TapPoint::due(std::int64_t now_ns) {
  std::int64_t next = next_ns_.load(std::memory_order_relaxed);
  return now_ns >= next && next_ns_.compare_exchange_strong(next, now_ns + pause_ns_, std::memory_order_relaxed);
}

void TapPoint::sample(const Tuple& tuple, int task) {
  const std::lock_guard lock(mutex_);
  if (ended_.load()) return;
  try {
    call_(tuple, task);
  } catch (const std::exception& error) {
    ended_.store(true);
    logger.error("who watches the tuples of task {} threw and watches no more: {}", task, error.what());
  }
}

void TapPoint::end() {
  const std::lock_guard lock(mutex_);
  ended_.store(true);
}

void Taps::add(std::shared_ptr<TapPoint> point) {
  const std::lock_guard lock(mutex_);
  points_.push_back(std::move(point));
  any_.store(true, std::memory_order_relaxed);
}

std::vector<std::shared_ptr<TapPoint>> Taps::due(std::int64_t now_ns) {
  std::vector<std::shared_ptr<TapPoint>> wanting;
  const std::lock_guard lock(mutex_);
  std::erase_if(points_, [](const auto& point) { return point->ended(); });
  any_.store(!points_.empty(), std::memory_order_relaxed);
  for (const auto& point : points_) {
    if (point->due(now_ns)) wanting.push_back(point);
  }
  return wanting;
}

}  // namespace iotcloud::topology::internal
