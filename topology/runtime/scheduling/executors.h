#pragma once

#include <atomic>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/scheduling/lane.h>

namespace iotcloud::topology::internal {

/// The executors of one component: a limit on how many of its tasks run at the same time. A task that finds all
/// executors busy waits in a queue until another task has ended its slice. The keys of a fields grouping belong to
/// tasks, and a change of the limit leaves tasks and mailboxes as they are, so it loses and reorders no tuple. Thread
/// safe.
class Executors {
 public:
  Executors(int limit, int tasks) : limit_(limit), tasks_(tasks), unlimited_(limit >= tasks) {}

  int limit() const { return limit_.load(std::memory_order_relaxed); }
  /// A lower limit takes effect as slices end. \return tasks that waited and may run now.
  ReadyList set_limit(int limit);

  /// Asks for an executor for a slice of `task`. \return false: all are busy and the task waits in the queue; the
  /// caller must not touch it any more. \param counted set to whether leave() must be called after the slice.
  bool enter(Runnable& task, bool& counted);
  /// Gives the executor back. \return a waiting task that may run now, or nullptr.
  Runnable* leave();

 private:
  std::atomic<int> limit_;
  const int tasks_;
  std::atomic<bool> unlimited_;  ///< the limit is at least the number of tasks, so nothing is counted
  config::Mutex mutex_;
  int busy_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  ReadyList aside_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology::internal
