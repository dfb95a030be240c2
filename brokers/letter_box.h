#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers {

/// Moves messages that are given up to a dead-letter topic, durable and with a queue of its own. The original is
/// accepted only when the broker has confirmed the letter, so a message is in at least one of the two queues at any
/// time; in both when the process ends in between. A letter that the broker refuses is rejected.
/// Thread safe. The broker outlives it.
class LetterBox {
 public:
  /// \param moved called for each original that was settled: true when its letter was confirmed, false when refused.
  LetterBox(Broker& broker, std::string topic, std::function<void(bool confirmed)> moved);

  /// \param letter the message with whatever says why it is given up. \param owner lives until the original is settled.
  void send(Message letter, Delivery original, std::shared_ptr<const void> owner = nullptr);
  /// Waits until the broker has answered for everything, `limit` at most.
  void drain(std::chrono::milliseconds limit) { static_cast<void>(publisher_->drain(limit)); }

 private:
  struct UnderWay {
    std::shared_ptr<const void> owner;
    Delivery original;  ///< dies first
  };
  void on_outcome(std::uint64_t number, Outcome outcome, const std::string& reason);

  const std::string topic_;
  const std::function<void(bool)> moved_;
  std::mutex mutex_;
  std::uint64_t last_number_ = 0;                ///< guarded by mutex_
  std::map<std::uint64_t, UnderWay> under_way_;  ///< by publish number; guarded by mutex_
  std::unique_ptr<Publisher> publisher_;         ///< dies first: no callback runs after it
};

/// What one broker object does with deliveries that its subscriptions reject or retry too often
/// (SubscriptionOptions::dead_letter, max_tries). Thread safe. Dies before the connections of its broker.
class DeadLetters {
 public:
  explicit DeadLetters(Broker& broker) : broker_(broker) {}
  /// A handler that keeps the subscription's rules and calls `handler`; `handler` itself when there are none.
  /// The result must not be called after this object's end.
  Handler guard(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  /// Waits until what is on its way to a dead-letter topic is there and its originals are settled, `limit` at most.
  void drain(const std::string& dead_letter, std::chrono::milliseconds limit);

 private:
  class Guard;
  LetterBox& box(const std::string& topic);

  Broker& broker_;
  std::mutex mutex_;
  std::map<std::string, std::unique_ptr<LetterBox>> boxes_;  ///< by topic; guarded by mutex_
};

}  // namespace iotcloud::brokers
