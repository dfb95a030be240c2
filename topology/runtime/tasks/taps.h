#pragma once

#include <atomic>
#include <memory>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology::internal {

/// A tap on one task: the call that gets the tuples, and how often it wants one.
class TapPoint {
 public:
  TapPoint(double per_second, TapCall call);
  /// Whether it is time for another sample. Of several threads one gets `true`, and the next sample is due a pause
  /// later.
  bool claim_sample(std::int64_t now_ns);
  void sample(const Tuple& tuple, int task);
  /// Waits until the call does not run any more; it is not made again.
  void end();
  bool ended() const { return ended_.load(); }

 private:
  const std::int64_t pause_ns_;
  std::atomic<std::int64_t> next_ns_{0};
  std::atomic<bool> ended_{false};
  config::Mutex mutex_;
  const TapCall call_;  ///< called with mutex_ held
};

/// The taps on one task. Without taps a tuple costs one read of an atomic.
class Taps {
 public:
  bool any() const { return any_.load(std::memory_order_relaxed); }
  void add(std::shared_ptr<TapPoint> point);
  /// Shows a tuple to the taps that are due. \param make makes the tuple; it is called only when a tap is due.
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
  config::Mutex mutex_;
  std::vector<std::shared_ptr<TapPoint>> points_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology::internal
