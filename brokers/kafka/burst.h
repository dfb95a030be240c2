#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::kafka {

/// What one thread publishes while it handles records that came together: it goes to the library together, as one
/// request. One by one they would be as many requests, because the library sends each as soon as it can.
///
/// Lives on that thread, which calls all of it, targets apart.
class Burst {
 public:
  using Instant = config::Clock::Instant;

  /// Whoever keeps messages back for a burst. Thread safe.
  class Target {
   public:
    explicit Target(std::function<void()> send) : send_(std::move(send)) {}
    /// Calls `send`, if not closed.
    void end() {
      const std::lock_guard lock(mutex_);
      if (send_) send_();
    }
    /// `send` is not called any more, and does not run.
    void close() {
      const std::lock_guard lock(mutex_);
      send_ = nullptr;
    }

   private:
    std::mutex mutex_;
    std::function<void()> send_;  ///< guarded by mutex_
  };

  Burst() : outer_(std::exchange(current_, this)) {}
  ~Burst() { current_ = outer_; }
  Burst(const Burst&) = delete;
  Burst& operator=(const Burst&) = delete;

  /// That of the calling thread; null when it has none.
  static Burst* of_this_thread() { return current_; }
  /// Whether more records wait behind the one that is handled now.
  void more_follow(bool more) { more_follow_ = more; }
  bool more_follow() const { return more_follow_; }
  void add(const std::shared_ptr<Target>& target, Instant now) {
    if (targets_.empty()) began_ = now;
    if (targets_.empty() || targets_.back() != target) targets_.push_back(target);
  }
  bool empty() const { return targets_.empty(); }
  /// When the first message was kept back, of a burst that is not empty.
  Instant began() const { return began_; }
  /// All that was kept back may be sent; the next one begins.
  void end() {
    for (const auto& target : std::exchange(targets_, {})) target->end();
  }

 private:
  inline static thread_local Burst* current_ = nullptr;
  Burst* const outer_;
  bool more_follow_ = false;
  Instant began_{};
  std::vector<std::shared_ptr<Target>> targets_;
};

}  // namespace iotcloud::brokers::kafka
