#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/topology/endpoints/receiving/held_messages.h>
#include <iotcloud/topology/endpoints/receiving/spout_queue.h>
#include <iotcloud/topology/endpoints/standstill_fence.h>
#include <iotcloud/topology/output_collector.h>

namespace iotcloud::topology {

/// Reads one topic into a SpoutQueue. Its owner must call close(). Thread safe.
class TopicReader : public TupleOrigin, public std::enable_shared_from_this<TopicReader> {
 public:
  /// The sender of the messages that do not name theirs: the driver instance is empty for a shared channel.
  struct Sender {
    discovery::GatewayId gateway;
    discovery::InstanceId driver;
  };
  /// Subscribes to the topic. With SubscriptionOptions::prefetch_limit the reader raises its prefetch, within that
  /// limit and the room in `held`, when bolts keep half of it.
  static std::shared_ptr<TopicReader> open(std::shared_ptr<brokers::Broker> broker,
                                           const brokers::BrokerAddress& address, const brokers::Topic& topic,
                                           const brokers::SubscriptionOptions& options, Sender sender,
                                           std::shared_ptr<SpoutQueue> queue,
                                           std::shared_ptr<const StandstillFence> fence,
                                           std::shared_ptr<HeldMessages> held);

  void pause();
  void resume();
  /// Takes no more messages, but stays subscribed, so that no other reader gets the topic. Only close() ends this.
  void drain();
  /// How many messages from this reader are neither settled nor given back to the broker.
  std::size_t in_hand() const { return in_hand_; }
  /// Whether as many such messages are there as the broker hands out.
  bool at_limit() const { return in_hand_ >= prefetch_; }
  /// How many such messages there may be now.
  std::size_t prefetch() const { return prefetch_; }
  /// Asks the broker how many messages wait there for this reader; does not wait for the answer.
  void ask_backlog();
  /// The answer to an earlier ask_backlog(); nullopt: there is none.
  std::optional<std::uint64_t> backlog() const;
  /// How many messages it has brought.
  std::size_t taken() const { return taken_; }
  /// Doubles the prefetch if bolts keep half of it, before they keep all of it, so that the broker goes on without a
  /// pause. To be called when the spout has taken a message of this reader.
  void raise_prefetch();
  /// Ends the subscription, and waits until no handler runs any more (unless a handler calls it). Messages that wait in
  /// the queue go back to the broker.
  void close();
  bool closed() const;
  /// Whether the fence was raised since open(). Messages that came before are void then, and the reader holds those
  /// that come after until it is closed.
  bool is_void() const { return fence_->count() != opened_at_; }
  /// Whether the broker delivers the messages of this reader again by itself: they are void, or it is closed.
  bool comes_again() const override { return closed() || is_void(); }
  /// StandstillFence::count() at open().
  std::uint64_t fence_count() const { return opened_at_; }
  /// Whether the broker delivers to this reader; false while disconnected, or while another reader has the topic.
  bool active() const;
  const Sender& sender() const { return sender_; }
  const brokers::Topic& topic() const { return topic_; }
  const brokers::BrokerAddress& address() const { return address_; }

 private:
  TopicReader(brokers::Topic topic, std::string name, brokers::BrokerAddress address, Sender sender,
              std::shared_ptr<SpoutQueue> queue, std::shared_ptr<const StandstillFence> fence,
              std::shared_ptr<HeldMessages> held, const brokers::SubscriptionOptions& options)
      : topic_(std::move(topic)),
        name_(std::move(name)),
        address_(std::move(address)),
        sender_(std::move(sender)),
        queue_(std::move(queue)),
        fence_(std::move(fence)),
        held_(std::move(held)),
        prefetch_limit_(options.automatic_ack ? std::size_t{0} : options.prefetch_limit),
        opened_at_(fence_->count()),
        prefetch_(options.prefetch) {}
  friend class HeldReader;
  void take_in_hand(std::size_t bytes) {
    ++in_hand_;
    bytes_ += bytes;
    held_->add(bytes);
  }
  void let_go(std::size_t bytes) {
    --in_hand_;
    bytes_ -= bytes;
    held_->remove(bytes);
  }
  void take(brokers::Delivery delivery);

  const brokers::Topic topic_;
  const std::string name_;  ///< for the log: the topic's, and "#" with the partition if it is not the first
  const brokers::BrokerAddress address_;
  const Sender sender_;
  const std::shared_ptr<SpoutQueue> queue_;
  const std::shared_ptr<const StandstillFence> fence_;
  const std::shared_ptr<HeldMessages> held_;
  const std::size_t prefetch_limit_;     ///< 0: the prefetch stays as it is
  const std::uint64_t opened_at_;        ///< StandstillFence::count() at open()
  std::atomic<bool> said_first_{false};  ///< the log has a line about the first message
  std::atomic<std::size_t> taken_{0};
  std::atomic<std::size_t> in_hand_{0};  ///< number of HeldReader objects of this reader
  std::atomic<std::size_t> bytes_{0};    ///< of their messages
  std::atomic<std::size_t> prefetch_;    ///< as the subscription has it
  mutable config::Mutex mutex_;
  bool closed_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool paused_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool draining_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::vector<brokers::Delivery> withheld_ IOTCLOUD_GUARDED_BY(mutex_);  ///< arrived after the fence was raised
  std::shared_ptr<brokers::Broker> broker_ IOTCLOUD_GUARDED_BY(mutex_);  ///< must outlive the subscription
  std::optional<std::uint64_t> backlog_ IOTCLOUD_GUARDED_BY(mutex_);
  /// Null until open() and after close().
  std::unique_ptr<brokers::Subscription> subscription_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology
