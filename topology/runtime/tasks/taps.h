#pragma once

#include <atomic>
#include <memory>
#include <thread>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology::internal {

/// The call of a tap, which gets the tuples of all tasks of its component. No lock is held while it runs, so it may end
/// its own tap. Thread safe.
class TapWatcher {
 public:
  explicit TapWatcher(TapCall call) : call_(std::move(call)) {}
  /// Runs the call on this thread, when no other thread runs it any more. A call that throws is not made again.
  void show(const Tuple& tuple, int task);
  /// The call is not made again. If another thread runs it now, waits for its end.
  void end();
  bool ended() const { return ended_.load(); }

 private:
  void run(const Tuple& tuple, int task);

  const TapCall call_;
  std::atomic<bool> ended_{false};
  config::Mutex mutex_;
  config::ConditionVariable left_;
  std::thread::id running_ IOTCLOUD_GUARDED_BY(mutex_);  ///< the thread that runs the call; no thread: nobody does
};

/// A tap on one task: how often its watcher wants a tuple.
class TapPoint {
 public:
  TapPoint(double per_second, std::shared_ptr<TapWatcher> watcher);
  /// Whether it is time for another sample. Of several threads one gets `true`, and the next sample is due a pause
  /// later.
  bool claim_sample(std::int64_t now_ns);
  TapWatcher& watcher() const { return *watcher_; }

 private:
  const std::int64_t pause_ns_;
  const std::shared_ptr<TapWatcher> watcher_;
  std::atomic<std::int64_t> next_ns_{0};
};

/// The taps on one task, and whether it tells traces of its tuples. Without both a tuple costs one read of an atomic.
class Taps {
 public:
  /// Whether there is a tap, or traces are told.
  bool any() const { return any_.load(std::memory_order_relaxed); }
  void add(std::shared_ptr<TapPoint> point);
  void trace(bool on);
  /// Shows a tuple to the taps that are due. \param make makes the tuple; it is called only when a tap is due.
  template <typename Make>
  void offer(std::int64_t now_ns, int task, Make&& make) {
    const std::vector<std::shared_ptr<TapPoint>> wanting = due(now_ns);
    if (wanting.empty()) return;
    const Tuple tuple = make();
    for (const auto& point : wanting) point->watcher().show(tuple, task);
  }

 private:
  std::vector<std::shared_ptr<TapPoint>> due(std::int64_t now_ns);

  std::atomic<bool> any_{false};
  config::Mutex mutex_;
  std::vector<std::shared_ptr<TapPoint>> points_ IOTCLOUD_GUARDED_BY(mutex_);
  bool traces_ IOTCLOUD_GUARDED_BY(mutex_) = false;
};

}  // namespace iotcloud::topology::internal
