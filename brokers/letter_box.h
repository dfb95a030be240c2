#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers {

/// Moves given up messages to a durable dead-letter topic with a queue of its own. It accepts the original only when
/// the broker has confirmed the letter, so a message is in at least one of the two queues at any time, and in both if
/// the process ends in between. If the broker refuses the letter, the original is rejected.
/// Thread safe. The broker must outlive it.
class LetterBox {
 public:
  /// \param moved called for each settled original: true if its letter was confirmed, false if it was refused.
  LetterBox(Broker& broker, std::string topic, std::function<void(bool confirmed)> moved);

  /// \param letter the message, with the reason why it was given up. \param owner kept until the original is settled.
  void send(Message letter, Delivery original, std::shared_ptr<const void> owner = nullptr);
  /// Waits until the broker has answered for all letters, `limit` at most.
  void drain(std::chrono::milliseconds limit) { static_cast<void>(publisher_->drain(limit)); }

 private:
  struct UnderWay {
    std::shared_ptr<const void> owner;
    Delivery original;  ///< destroyed first
  };
  void on_outcome(std::uint64_t number, Outcome outcome, const std::string& reason);

  const std::string topic_;
  const std::function<void(bool)> moved_;
  config::Mutex mutex_;
  std::map<std::uint64_t, UnderWay> under_way_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by publish number
  std::unique_ptr<Publisher> publisher_;  ///< destroyed first, so that no callback runs after it
};

/// How one broker object treats deliveries that its subscriptions reject or retry too often
/// (SubscriptionOptions::dead_letter, max_tries). Thread safe. Must be destroyed before its broker's connections.
class DeadLetters {
 public:
  explicit DeadLetters(Broker& broker) : broker_(broker) {}
  /// Wraps `handler` in the subscription's rules; returns `handler` itself if it has none.
  /// The result must not be called after this object is destroyed.
  Handler guard(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  /// Waits until all letters to a dead-letter topic are confirmed and their originals settled, `limit` at most.
  void drain(const std::string& dead_letter, std::chrono::milliseconds limit);

 private:
  class Guard;
  LetterBox& box(const std::string& topic);

  Broker& broker_;
  config::Mutex mutex_;
  std::map<std::string, std::unique_ptr<LetterBox>> boxes_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by topic
};

}  // namespace iotcloud::brokers
