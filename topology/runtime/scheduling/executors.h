#pragma once

#include <atomic>
#include <mutex>

#include <iotcloud/topology/runtime/scheduling/lane.h>

namespace iotcloud::topology::internal {

/// The executors of one component: how many of its tasks may run at the same time. A task that finds all of them busy
/// stands aside, in turn, until another one has done its slice. As the keys of a fields grouping belong to tasks, and a
/// task and its mailbox stay what they are, a change loses and reorders nothing. Thread safe.
class Executors {
 public:
  Executors(int limit, int tasks) : limit_(limit), tasks_(tasks), unlimited_(limit >= tasks) {}

  int limit() const { return limit_.load(std::memory_order_relaxed); }
  /// Takes effect as slices end. \return tasks that stood aside and may run now.
  ReadyList set_limit(int limit);

  /// \return false: all are busy, the task stands aside and is not to be touched any more.
  /// \param counted whether leave() must be called after the slice.
  bool enter(Task& task, bool& counted);
  /// \return the task that may run now, or nullptr.
  Task* leave();

 private:
  std::atomic<int> limit_;
  const int tasks_;
  std::atomic<bool> unlimited_;  ///< as many as there are tasks: nobody counts
  std::mutex mutex_;
  int busy_ = 0;     ///< guarded by mutex_
  ReadyList aside_;  ///< guarded by mutex_
};

}  // namespace iotcloud::topology::internal
