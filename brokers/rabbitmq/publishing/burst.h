#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::rabbitmq {

class PublishLink;

/// A publishing connection that others mean to call later, when it may be gone. Thread safe.
class Reachable {
 public:
  explicit Reachable(PublishLink& link) : link_(&link) {}
  /// The link dies; waits for a push() that runs.
  void gone();
  /// PublishLink::push(), if the link is still there.
  void push();

 private:
  std::mutex mutex_;
  PublishLink* link_;  ///< guarded by mutex_
};

/// Stands on the stack of a thread that hands on messages which came together. What the handlers publish meanwhile, on
/// this thread, may leave together, too: one packet of many messages costs this host and the server far less than as
/// many packets. Held back only while the next handler follows at once; the end of the burst sends all.
class Burst {
 public:
  explicit Burst(const config::Clock& clock) : clock_(clock), outer_(std::exchange(innermost, this)) {}
  ~Burst();
  Burst(const Burst&) = delete;
  Burst& operator=(const Burst&) = delete;

  /// Before each handler. \param follows another message waits. \param quick its handler was quick the last time
  void before_handler(bool follows, bool quick);
  /// After it. \return whether it was quick; nothing when that was not measured, for a lone message
  std::optional<bool> after_handler();
  /// The calling thread's, when what is published now may be held back; otherwise null.
  static Burst* going_on() { return innermost != nullptr && innermost->holds_back_ ? innermost : nullptr; }
  /// This link holds something back.
  void remember(std::shared_ptr<Reachable> link) { links_.push_back(std::move(link)); }

 private:
  static thread_local Burst* innermost;

  const config::Clock& clock_;
  Burst* const outer_;  ///< of the same thread
  bool holds_back_ = false;
  std::optional<config::Clock::Instant> began_;
  config::Clock::Instant last_{};  ///< when the last handler ended
  std::vector<std::shared_ptr<Reachable>> links_;
};

}  // namespace iotcloud::brokers::rabbitmq
