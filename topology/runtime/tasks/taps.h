#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <vector>

#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology::internal {

/// Someone who watches tuples: the call, and how often it wants one.
class TapPoint {
 public:
  TapPoint(double per_second, TapCall call);
  /// Whether it is time for another sample.
  bool due(std::int64_t now_ns);
  void sample(const Tuple& tuple, int task);
  /// Returns when the call does not run any more; it never will again.
  void end();
  bool ended() const { return ended_.load(); }

 private:
  const std::int64_t pause_ns_;
  std::atomic<std::int64_t> next_ns_{0};
  std::atomic<bool> ended_{false};
  std::mutex mutex_;
  const TapCall call_;  ///< runs with mutex_ held
};

/// Those who watch one task. Costs one look at an atomic while there is nobody.
class Taps {
 public:
  bool any() const { return any_.load(std::memory_order_relaxed); }
  void add(std::shared_ptr<TapPoint> point);
  /// \param make makes the tuple; called when somebody wants one.
  template <typename Make>
  void offer(std::int64_t now_ns, int task, Make&& make) {
    const std::vector<std::shared_ptr<TapPoint>> wanting = due(now_ns);
    if (wanting.empty()) return;
    const Tuple tuple = make();
    for (const auto& point : wanting) point->sample(tuple, task);
  }

 private:
  std::vector<std::shared_ptr<TapPoint>> due(std::int64_t now_ns);

  std::atomic<bool> any_{false};
  std::mutex mutex_;
  std::vector<std::shared_ptr<TapPoint>> points_;  ///< guarded by mutex_
};

}  // namespace iotcloud::topology::internal
