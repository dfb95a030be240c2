#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

/// The keep_last of one input: of its waiting tuples the mailbox keeps the newest `keep` of each key.
struct KeepLast {
  const detail::StreamInfo* stream = nullptr;
  std::size_t keep = 1;
  std::vector<std::size_t> key;  ///< positions of the key's values in the tuple; empty: all tuples have one key
};

/// The queue of a mailbox of which some inputs have keep_last. A key keeps its place in the queue: a newer tuple is
/// executed when the one that it replaces would have been. Not thread safe.
class Conflater {
 public:
  explicit Conflater(std::vector<KeepLast> inputs) : inputs_(std::move(inputs)) {}
  /// Adds a tuple. \return the tuple that it replaces, which the caller must ack and release, or nullptr.
  TupleCell* put(TupleCell* cell);
  TupleCell* take();  ///< removes the next tuple; nullptr: nothing waits

 private:
  using Kept = std::deque<TupleCell*>;
  struct Place {
    TupleCell* cell = nullptr;         ///< a tuple of an input without keep_last
    const std::string* key = nullptr;  ///< if `cell` is null: stands for the oldest tuple of this key
  };
  std::string key_of(const KeepLast& input, const TupleCell& cell) const;

  std::vector<KeepLast> inputs_;
  std::deque<Place> line_;
  std::unordered_map<std::string, Kept> by_key_;  ///< has only keys of which tuples wait
};

/// The queue of tuples of a bolt task. Emitting tasks add tuples in batches. A task whose target mailbox is full
/// does not run until the mailbox is half empty. put(), block_until_room(), depth(), room() and superseded() may be
/// called on any thread, next() and done() only in the task's slices.
class Mailbox {
 public:
  /// \param owner the task that receives the tuples. \param capacity of tuples; at least 2 is used.
  Mailbox(const Task& owner, std::size_t capacity, std::vector<KeepLast> keep_last);

  /// Adds tuples and takes over one handle of each.
  void put(std::span<TupleCell* const> cells);
  /// Blocks `emitter` (Task::block()) until the mailbox is half empty. \return false when it is so already.
  bool block_until_room(Task& emitter);
  std::size_t depth() const { return depth_.load(std::memory_order_relaxed); }
  std::size_t room() const {
    const std::size_t now = depth();
    return now < capacity_ ? capacity_ - now : 0;
  }
  /// Number of tuples that a newer one has replaced (keep_last).
  std::uint64_t superseded() const { return superseded_.load(std::memory_order_relaxed); }

  /// Removes the next tuple; nullptr: nothing waits. depth() counts the tuple until done().
  TupleCell* next();
  /// Says that so many tuples of next() were executed; unblocks emitters when the mailbox is half empty.
  void done(std::size_t executed);
  /// Releases the tuples that still wait. \pre no thread runs a task any more.
  void discard();

 private:
  void put_conflated(std::span<TupleCell* const> cells);

  const Task& owner_;
  const std::size_t capacity_;
  std::vector<TupleCell*> batch_;  ///< taken from waiting_, so that the lock is taken once for many tuples
  std::vector<Task*> freed_;       ///< only used in done(); a member, to keep its memory
  std::size_t next_ = 0;           ///< index into batch_

  std::atomic<std::size_t> depth_{0};
  std::atomic<bool> has_blocked_{false};
  std::atomic<std::uint64_t> superseded_{0};
  config::Mutex mutex_;
  std::vector<TupleCell*> waiting_ IOTCLOUD_GUARDED_BY(mutex_);
  /// Used instead of waiting_ when an input has keep_last; null otherwise.
  std::unique_ptr<Conflater> conflater_ IOTCLOUD_PT_GUARDED_BY(mutex_);
  std::vector<Task*> blocked_ IOTCLOUD_GUARDED_BY(mutex_);  ///< emitters that wait for room
};

}  // namespace iotcloud::topology::internal
