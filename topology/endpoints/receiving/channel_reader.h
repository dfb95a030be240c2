#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/topology/endpoints/fence.h>
#include <iotcloud/topology/endpoints/receiving/inbox.h>

namespace iotcloud::topology {

/// One topic being read into an inbox. Thread safe. Its owner closes it.
class ChannelReader : public std::enable_shared_from_this<ChannelReader> {
 public:
  /// \param driver_id whose messages these are when they do not say so themselves; empty for a shared channel.
  static std::shared_ptr<ChannelReader> open(std::shared_ptr<brokers::Broker> broker,
                                             const brokers::BrokerAddress& address, const brokers::Topic& topic,
                                             const brokers::SubscriptionOptions& options, std::string driver_id,
                                             std::shared_ptr<Inbox> inbox, std::shared_ptr<const Fence> fence);

  void pause();
  void resume();
  /// Takes nothing more from the broker, and keeps the topic; until it is closed.
  void drain();
  /// Whether a message from here is on its way in the topology: not settled, nor given back.
  bool has_in_hand() const { return in_hand_ > 0; }
  /// Returns when nothing comes any more (unless called from within a handler); what waits goes back to the broker.
  void close();
  bool closed() const;
  /// True when the fence was put up since open(): what came from here is void, and what comes stays with the reader
  /// until it is closed.
  bool is_void() const { return fence_->count() != opened_at_; }
  /// How often the fence had been put up at open().
  std::uint64_t fence_count() const { return opened_at_; }
  /// True while it reads; false while disconnected, or while another reader has the topic.
  bool active() const;
  const std::string& driver_id() const { return driver_id_; }
  const brokers::Topic& topic() const { return topic_; }
  const brokers::BrokerAddress& address() const { return address_; }

 private:
  ChannelReader(brokers::Topic topic, brokers::BrokerAddress address, std::string driver_id,
                std::shared_ptr<Inbox> inbox, std::shared_ptr<const Fence> fence)
      : topic_(std::move(topic)),
        address_(std::move(address)),
        driver_id_(std::move(driver_id)),
        inbox_(std::move(inbox)),
        fence_(std::move(fence)),
        opened_at_(fence_->count()) {}
  friend class HeldReader;
  void take_in_hand() { ++in_hand_; }
  void let_go() { --in_hand_; }
  void take(brokers::Delivery delivery);

  const brokers::Topic topic_;
  const brokers::BrokerAddress address_;
  const std::string driver_id_;
  const std::shared_ptr<Inbox> inbox_;
  const std::shared_ptr<const Fence> fence_;
  const std::uint64_t opened_at_;  ///< the fence's count
  std::atomic<bool> said_first_{false};
  std::atomic<std::size_t> in_hand_{0};
  mutable std::mutex mutex_;
  bool closed_ = false;                                  ///< guarded by mutex_
  bool paused_ = false;                                  ///< guarded by mutex_
  bool draining_ = false;                                ///< guarded by mutex_
  std::vector<brokers::Delivery> withheld_;              ///< came when all was void already; guarded by mutex_
  std::shared_ptr<brokers::Broker> broker_;              ///< guarded by mutex_; outlives the subscription
  std::unique_ptr<brokers::Subscription> subscription_;  ///< guarded by mutex_; null until open() and after close()
};

}  // namespace iotcloud::topology
