#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

/// `keep_last` of one input: of its tuples that wait only the newest `keep` of each key stay.
struct KeepLast {
  const detail::StreamInfo* stream = nullptr;
  std::size_t keep = 1;
  std::vector<std::size_t> key;  ///< positions in the tuple; empty: one key
};

/// Tuples that wait for a task some of whose inputs keep only the newest. A key keeps its place in the line: a newer
/// tuple is executed when the one that it replaces would have been. Not thread safe.
class Conflater {
 public:
  explicit Conflater(std::vector<KeepLast> inputs) : inputs_(std::move(inputs)) {}
  /// \return what the tuple has replaced, or nullptr.
  TupleCell* put(TupleCell* cell);
  TupleCell* take();  ///< nullptr: nothing waits

 private:
  using Kept = std::deque<TupleCell*>;
  struct Place {
    TupleCell* cell = nullptr;         ///< of an input that keeps all
    const std::string* key = nullptr;  ///< else: the oldest of this key
  };
  std::string key_of(const KeepLast& input, const TupleCell& cell) const;

  std::vector<KeepLast> inputs_;
  std::deque<Place> line_;
  std::unordered_map<std::string, Kept> by_key_;  ///< only keys of which something waits
};

/// A bolt task's queue of tuples. Emitters put them in batches; when so many wait that it is full, they are not run
/// again until half of them are gone. put() and block_until_room() are for any thread, the rest for the task's own.
class Mailbox {
 public:
  /// \param owner whose deliveries they are.
  Mailbox(const Task& owner, std::size_t capacity, std::vector<KeepLast> keep_last);

  /// Takes over one handle of each.
  void put(std::span<TupleCell* const> cells);
  /// Makes `emitter` wait until there is room. \return false when there is room already.
  bool block_until_room(Task& emitter);
  std::size_t depth() const { return depth_.load(std::memory_order_relaxed); }
  std::size_t room() const {
    const std::size_t now = depth();
    return now < capacity_ ? capacity_ - now : 0;
  }
  /// Tuples that a newer one has replaced.
  std::uint64_t superseded() const { return superseded_.load(std::memory_order_relaxed); }

  /// The next one; nullptr: nothing waits. It counts as waiting until done().
  TupleCell* next();
  void done(std::size_t executed);
  /// Gives back what still waits. When nothing runs.
  void discard();

 private:
  void put_conflated(std::span<TupleCell* const> cells);

  const Task& owner_;
  const std::size_t capacity_;
  std::vector<TupleCell*> batch_;
  std::vector<Task*> freed_;  ///< scratch, keeps its memory
  std::size_t next_ = 0;      ///< in batch_

  std::atomic<std::size_t> depth_{0};
  std::atomic<bool> has_blocked_{false};
  std::atomic<std::uint64_t> superseded_{0};
  std::mutex mutex_;
  std::vector<TupleCell*> waiting_;       ///< guarded by mutex_
  std::unique_ptr<Conflater> conflater_;  ///< guarded by mutex_; instead of waiting_; null: all inputs keep all
  std::vector<Task*> blocked_;            ///< guarded by mutex_: emitters that wait for room
};

}  // namespace iotcloud::topology::internal
