#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/tasks/conflater.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

/// The queue of tuples of a bolt task. Emitting tasks add tuples in batches. A task whose target mailbox is full
/// does not run until the mailbox is half empty. put(), block_until_room(), depth(), room() and superseded() may be
/// called on any thread, the others only in the task's slices, and hand() by whoever has taken the task.
class Mailbox {
 public:
  /// \param owner the task that receives the tuples. \param capacity of tuples; at least 2 is used.
  Mailbox(const Task& owner, std::size_t capacity, std::vector<KeepLast> keep_last);

  /// Adds tuples and takes over one handle of each.
  void put(std::span<TupleCell* const> cells);
  /// As put(). If nothing waits, the list itself changes its owner, and no tuple is copied. \pre the caller has taken
  /// the task (Scheduler::take()). \param cells are left with any content.
  void hand(CellList& cells);
  /// Blocks `emitter` (Task::block()) until the mailbox is half empty. \return false when it is so already.
  bool block_until_room(Task& emitter);
  std::size_t depth() const { return depth_.load(std::memory_order_relaxed); }
  std::size_t room() const {
    const std::size_t now = depth();
    return now < capacity_ ? capacity_ - now : 0;
  }
  /// Number of tuples that a newer one has replaced (keep_last).
  std::uint64_t superseded() const { return superseded_.load(std::memory_order_relaxed); }

  /// The next tuples, in order; empty: nothing waits. They wait until took() says that they were taken, and depth()
  /// counts them until done().
  std::span<TupleCell* const> next() {
    if (next_ == batch_.size() && !next_batch()) return {};
    return {batch_.begin() + next_, batch_.end()};
  }
  void took(std::size_t count) { next_ += count; }
  /// Says that so many tuples of next() were executed; unblocks emitters when the mailbox is half empty.
  void done(std::size_t executed);
  /// Releases the tuples that still wait. \pre no thread runs a task any more.
  void discard();

 private:
  bool next_batch();
  void put_conflated(std::span<TupleCell* const> cells);

  const Task& owner_;
  const std::size_t capacity_;
  CellList batch_;            ///< taken from waiting_, so that the lock is taken once for many tuples
  std::vector<Task*> freed_;  ///< only used in done(); a member, to keep its memory
  std::size_t next_ = 0;      ///< index into batch_

  std::atomic<std::size_t> depth_{0};
  std::atomic<bool> has_blocked_{false};
  std::atomic<std::uint64_t> superseded_{0};
  config::Mutex mutex_;
  CellList waiting_ IOTCLOUD_GUARDED_BY(mutex_);
  /// Used instead of waiting_ when an input has keep_last; null otherwise.
  std::unique_ptr<Conflater> conflater_ IOTCLOUD_PT_GUARDED_BY(mutex_);
  std::vector<Task*> blocked_ IOTCLOUD_GUARDED_BY(mutex_);  ///< emitters that wait for room
};

}  // namespace iotcloud::topology::internal
