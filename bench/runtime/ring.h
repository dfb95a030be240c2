#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <thread>
#include <utility>

namespace iotcloud::bench {

/// Lets a thread wait for rings to change: first it yields a few times, then it sleeps.
class Doorbell {
 public:
  /// Returns when `ready()`. Only one thread may wait.
  template <typename Ready>
  void wait(Ready&& ready) {
    for (int i = 0; i < 20; ++i) {
      if (ready()) return;
      std::this_thread::yield();
    }
    while (true) {
      const std::uint32_t seen = rung_.load(std::memory_order_acquire);
      asleep_.store(true, std::memory_order_seq_cst);
      std::atomic_thread_fence(std::memory_order_seq_cst);
      if (ready()) break;
      rung_.wait(seen);
    }
    asleep_.store(false, std::memory_order_relaxed);
  }
  /// Must be called after each change. Any thread.
  void ring() {
    std::atomic_thread_fence(std::memory_order_seq_cst);
    if (!asleep_.load(std::memory_order_relaxed)) return;
    asleep_.store(false, std::memory_order_relaxed);
    rung_.fetch_add(1, std::memory_order_release);
    rung_.notify_one();
  }

 private:
  alignas(64) std::atomic<bool> asleep_{false};
  std::atomic<std::uint32_t> rung_{0};
};

/// A ring between one thread that puts items and one that takes them, in batches.
template <typename T, std::size_t capacity = 1024>
class Ring {
 public:
  static constexpr std::size_t batch = 64;

  /// \param not_empty wakes the taker. \param not_full wakes the putter.
  Ring(Doorbell& not_empty, Doorbell& not_full) : not_empty_(not_empty), not_full_(not_full) {}

  // Called by the putter.
  /// Waits while the ring is full. The taker sees the item when its batch is complete, or after flush().
  void put(T&& item) {
    if (written_ - known_head_ == capacity) make_room();
    items_[written_++ % capacity] = std::move(item);
    if (written_ % batch == 0) flush();
  }
  void flush() {
    if (tail_.load(std::memory_order_relaxed) == written_) return;
    tail_.store(written_, std::memory_order_release);
    not_empty_.ring();
  }

  // Called by the taker.
  bool empty() const { return tail_.load(std::memory_order_acquire) == taken_; }
  /// Calls `each(T&&)` for at most a batch of items. \return how many.
  template <typename Each>
  std::size_t take(Each&& each) {
    const std::size_t there = std::min(tail_.load(std::memory_order_acquire) - taken_, std::size_t{batch});
    for (std::size_t i = 0; i < there; ++i) each(std::move(items_[taken_++ % capacity]));
    if (there > 0) {
      head_.store(taken_, std::memory_order_release);
      not_full_.ring();
    }
    return there;
  }

 private:
  void make_room() {
    flush();
    const auto has_room = [this] {
      return written_ - (known_head_ = head_.load(std::memory_order_acquire)) < capacity;
    };
    if (!has_room()) not_full_.wait(has_room);
  }
  Doorbell& not_empty_;
  Doorbell& not_full_;
  alignas(64) std::atomic<std::size_t> head_{0};  ///< all items before it were taken
  std::size_t taken_ = 0;                         ///< used by the taker
  alignas(64) std::atomic<std::size_t> tail_{0};  ///< all items before it may be taken
  std::size_t written_ = 0;                       ///< used by the putter
  std::size_t known_head_ = 0;                    ///< used by the putter
  alignas(64) std::array<T, capacity> items_;
};

}  // namespace iotcloud::bench
