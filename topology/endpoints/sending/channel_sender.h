#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/services.h>
#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology {

/// Counters of the senders of one component, by outcome of their messages.
class SenderMeters {
 public:
  SenderMeters(config::Metrics& metrics, config::Labels labels) : metrics_(metrics), labels_(std::move(labels)) {}
  void accepted() { accepted_.add(); }
  /// \param reason "superseded", "deadline", "refused", ...
  void lost(const std::string& reason);

 private:
  config::Metrics& metrics_;
  const config::Labels labels_;
  config::Counter& accepted_ = metrics_.counter("iotcloud_bolt_sent_total", "Messages that a publisher took", labels_);
};

/// Sends to one topic, in order, for all tasks of a bolt. It acks a tracked tuple when the broker has confirmed its
/// message, or when the channel's own policy dropped the message (superseded, too old); it fails the tuple when the
/// broker refused the message. When the outcome is unknown, or the channel has gone, the tuple is to be tried again and
/// its message not to blame (OutputCollector::retry()), however often that happens. While the publisher is full it
/// holds tuples back unacked, so that the spout stops at its limit of unsettled messages or of tuples under way. A
/// tuple that was born before the fence was raised is not sent, and to be tried again, too. Thread safe.
class ChannelSender : public std::enable_shared_from_this<ChannelSender> {
 public:
  /// What a tuple's collector is told.
  enum class Answer { ack, fail, retry };

  /// \param ack_when accepted: a tuple is acked when the publisher has taken its message, which may still be lost.
  static std::shared_ptr<ChannelSender> open(std::shared_ptr<brokers::Broker> broker, const brokers::Topic& topic,
                                             brokers::PublisherOptions options, AckWhen ack_when,
                                             const std::shared_ptr<SenderMeters>& meters,
                                             const std::shared_ptr<const StandstillFence>& fence);

  /// Sends the message, and answers for the tuple, before it returns or later. \param age how long the message has
  /// waited; its deadline counts from so long ago.
  void send(brokers::Message message, const Tuple& tuple, OutputCollector& collector,
            std::chrono::milliseconds age = {});
  /// Restarts the message time-out of all tuples that are held back or not confirmed, so that they do not time out
  /// while the broker is away.
  void reset_timeouts();
  /// Forgets all tuples of a collector that is about to go. Returns when none of them is being sent or answered for.
  void forget(const OutputCollector& collector);
  /// Closes the publisher, and has the tuples tried again that are held back or not confirmed.
  void close();

 private:
  struct Held {
    brokers::Message message;
    Tuple tuple;
    OutputCollector* collector;
    std::chrono::milliseconds age;
  };
  /// A tracked tuple whose message the publisher has taken, or is about to take.
  struct UnderWay {
    std::uint64_t number;  ///< the publisher's number of the message
    Tuple tuple;
    OutputCollector* collector;  ///< null: the tuple was answered for, or forgotten
  };
  ChannelSender(AckWhen ack_when, std::shared_ptr<SenderMeters> meters, std::shared_ptr<const StandstillFence> fence)
      : ack_when_(ack_when), meters_(std::move(meters)), fence_(std::move(fence)) {}
  bool is_void(const Tuple& tuple) const;
  void pump() IOTCLOUD_REQUIRES(mutex_);
  void on_outcome(std::uint64_t number, Answer answer);
  void on_writable();

  /// How many tuples are held back at most; further ones are tried again later. A topology that reaches this has spouts
  /// without a limit of tuples under way.
  static constexpr std::size_t most_held = 100'000;

  const AckWhen ack_when_;
  const std::shared_ptr<SenderMeters> meters_;
  const std::shared_ptr<const StandstillFence> fence_;
  config::Mutex mutex_;
  config::ConditionVariable sent_;                                       ///< signals changes of sending_ and answering_
  std::shared_ptr<brokers::Broker> broker_ IOTCLOUD_GUARDED_BY(mutex_);  ///< must outlive the publisher
  std::shared_ptr<brokers::Publisher> publisher_ IOTCLOUD_GUARDED_BY(mutex_);  ///< null when closed
  std::deque<Held> held_ IOTCLOUD_GUARDED_BY(mutex_);
  std::deque<UnderWay> under_way_ IOTCLOUD_GUARDED_BY(mutex_);  ///< ordered by number
  std::uint64_t last_number_ IOTCLOUD_GUARDED_BY(mutex_) = 0;   ///< the number that publish() returned last; 0: none
  std::vector<OutputCollector*> answering_
      IOTCLOUD_GUARDED_BY(mutex_);                                  ///< collectors whose tuples are being answered for
  bool full_ IOTCLOUD_GUARDED_BY(mutex_) = false;                   ///< true until on_writable()
  OutputCollector* sending_ IOTCLOUD_GUARDED_BY(mutex_) = nullptr;  ///< the collector whose tuple a thread is sending
  bool writable_again_ IOTCLOUD_GUARDED_BY(mutex_) = false;         ///< on_writable() was called while sending
};

}  // namespace iotcloud::topology
