#pragma once

#include <chrono>
#include <cstddef>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/host/event_loop.h>

namespace iotcloud::gateway {

/// Messages of one incoming channel of one instance, on their way from the broker's thread to the instance's event
/// thread. What waits is bounded by the subscription's prefetch, or by `keep_last`, which drops the oldest. Thread
/// safe.
class Inbox : public std::enable_shared_from_this<Inbox> {
 public:
  /// \param deliver runs on the loop, one message at a time. \return false: the driver failed on it.
  using Deliver = std::function<bool(brokers::Message)>;
  Inbox(std::shared_ptr<EventLoop> loop, std::size_t keep_last, config::Counter& superseded, Deliver deliver);

  /// The delivery is accepted when the driver has handled it, rejected when the driver failed on it.
  void push(brokers::Delivery delivery);
  /// Nothing is delivered any more (at once, on the loop's thread); what waits goes back to the broker.
  void close();

 private:
  void drain();

  const std::shared_ptr<EventLoop> loop_;
  const std::size_t keep_last_;
  config::Counter& superseded_;
  const Deliver deliver_;
  std::mutex mutex_;
  std::deque<brokers::Delivery> waiting_;  ///< guarded by mutex_
  bool scheduled_ = false;                 ///< guarded by mutex_
  bool closed_ = false;                    ///< guarded by mutex_
};

/// The shared incoming channels of one host: one subscription for each topic, whose messages go to the instance that
/// `driver_id` names. Messages for an instance that is not here are dropped, counted, and logged once per burst.
/// Thread safe.
class SharedInboxes {
 public:
  SharedInboxes(const config::Clock& clock, config::Metrics& metrics) : clock_(clock), metrics_(metrics) {}

  void join(const std::shared_ptr<brokers::Broker>& broker, const brokers::Topic& topic, const std::string& instance,
            std::shared_ptr<Inbox> inbox);
  /// The last one to leave ends the subscription.
  void leave(const std::string& url, const brokers::Topic& topic, const std::string& instance);

 private:
  struct Hub;
  using Key = std::pair<std::string, std::string>;  ///< broker URL, topic name
  const config::Clock& clock_;
  config::Metrics& metrics_;
  std::mutex mutex_;
  std::map<Key, std::shared_ptr<Hub>> hubs_;  ///< guarded by mutex_
};

}  // namespace iotcloud::gateway
