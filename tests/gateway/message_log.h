#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::gateway {

/// Reads a topic, as a topology would, and returns its messages one by one.
class MessageLog {
 public:
  MessageLog(const std::string& url, const brokers::Topic& topic) {
    brokers::BrokerOptions options;
    options.urls = {url};
    broker_ = brokers::make_broker(options);
    brokers::SubscriptionOptions subscription;
    subscription.group = "test";
    subscription_ = broker_->subscribe(topic, subscription, [this](brokers::Delivery delivery) {
      const std::lock_guard lock(mutex_);
      messages_.push_back(delivery.message);
      delivery.settle(brokers::Settlement::accept);
      changed_.notify_all();
    });
  }

  /// \return nullopt if no message came within 20 s.
  std::optional<brokers::Message> next() {
    std::unique_lock lock(mutex_);
    if (!changed_.wait_for(lock, tests::patience, [&] { return !messages_.empty(); })) return std::nullopt;
    auto message = std::move(messages_.front());
    messages_.pop_front();
    return message;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<brokers::Message> messages_;  ///< guarded by mutex_
  std::unique_ptr<brokers::Broker> broker_;
  std::unique_ptr<brokers::Subscription> subscription_;
};

/// Sends to a driver's incoming channel, as a topology would.
class MessageSender {
 public:
  MessageSender(const std::string& url, const brokers::Topic& topic) {
    brokers::BrokerOptions options;
    options.urls = {url};
    broker_ = brokers::make_broker(options);
    publisher_ = broker_->publisher(topic, {});
  }
  ~MessageSender() { publisher_->drain(tests::patience); }

  /// \param time_ms of the message that it answers; 0: it answers none
  void send(const std::string& text, const std::string& instance, std::int64_t time_ms = 0) {
    brokers::Message message;
    message.time_ms = time_ms;
    message.payload = brokers::Payload::copy(text);
    message.driver_id = instance;
    publisher_->publish(std::move(message));
  }

 private:
  std::unique_ptr<brokers::Broker> broker_;
  std::unique_ptr<brokers::Publisher> publisher_;
};

}  // namespace iotcloud::gateway
