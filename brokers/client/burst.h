#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::client {

/// Lives on the stack of a thread that runs the handlers of messages which arrived together. Messages that the handlers
/// publish on this thread may be sent together: one packet with many messages costs this host and the server far less
/// than many packets. They are held back only while the next handler follows at once; the destructor sends them all.
class Burst {
 public:
  /// A connection that holds bytes back. It may be destroyed before the burst ends. Thread safe.
  class Target {
   public:
    explicit Target(std::function<void()> push) : push_(std::move(push)) {}
    /// Makes the connection send what it holds back, unless close() was called.
    void push() IOTCLOUD_EXCLUDES(mutex_);
    /// To be called when the connection ends: when it has returned, `push` neither runs nor will run.
    void close() IOTCLOUD_EXCLUDES(mutex_);

   private:
    config::Mutex mutex_;
    std::function<void()> push_ IOTCLOUD_GUARDED_BY(mutex_);
  };

  explicit Burst(const config::Clock& clock) : clock_(clock), outer_(std::exchange(innermost, this)) {}
  ~Burst();
  Burst(const Burst&) = delete;
  Burst& operator=(const Burst&) = delete;

  /// To be called before each handler. \param follows whether another message waits. \param quick whether the handler
  /// was quick the last time
  void before_handler(bool follows, bool quick);
  /// To be called after each handler. \return whether it was quick; nothing for a single message, whose handler is not
  /// timed
  std::optional<bool> after_handler();
  /// The calling thread's burst if a message published now may be held back; otherwise null.
  static Burst* going_on() { return innermost != nullptr && innermost->holds_back_ ? innermost : nullptr; }
  /// Notes that this connection holds bytes back, which the destructor sends.
  void remember(std::shared_ptr<Target> target) { targets_.push_back(std::move(target)); }

 private:
  static thread_local Burst* innermost;

  const config::Clock& clock_;
  Burst* const outer_;  ///< the burst of the same thread around this one; null: none
  bool holds_back_ = false;
  std::optional<config::Clock::Instant> began_;
  config::Clock::Instant last_{};  ///< when the last handler ended
  std::vector<std::shared_ptr<Target>> targets_;
};

}  // namespace iotcloud::brokers::client
