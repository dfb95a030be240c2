#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/services.h>
#include <iotcloud/topology/output_collector.h>
#include <iotcloud/topology/tuple.h>

namespace iotcloud::topology {

/// What senders of one component count, by what became of their messages.
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

/// Sends to one topic, in order, for all tasks of a bolt. A tracked tuple is acked when the broker has confirmed its
/// message, or when the channel's own policy dropped it (superseded, too old); it fails when the broker refused it, or
/// when nobody knows what became of it. While the publisher is full tuples are held back unacked, which stops the
/// spout. So what waits is limited by the publisher's capacity. What comes from before the
/// fence was put up is not sent: its tuple fails. Thread safe.
class ChannelSender : public std::enable_shared_from_this<ChannelSender> {
 public:
  /// \param ack_when accepted: a tuple is acked when the publisher has its message, which may still be lost.
  static std::shared_ptr<ChannelSender> open(std::shared_ptr<brokers::Broker> broker, const brokers::Topic& topic,
                                             brokers::PublisherOptions options, AckWhen ack_when,
                                             const std::shared_ptr<SenderMeters>& meters,
                                             const std::shared_ptr<const Fence>& fence);

  /// Acks or fails the tuple, now or later.
  void send(brokers::Message message, const Tuple& tuple, OutputCollector& collector);
  /// What is held back, and what the broker has not confirmed, does not time out meanwhile.
  void reset_timeouts();
  /// The collector goes: its tuples are forgotten. Returns when none of them is being sent or answered.
  void forget(const OutputCollector& collector);
  /// Fails what is held back, closes the publisher; what it has not confirmed fails.
  void close();

 private:
  struct Held {
    brokers::Message message;
    Tuple tuple;
    OutputCollector* collector;
  };
  /// A tracked tuple whose message the publisher has, or is being given.
  struct UnderWay {
    std::uint64_t number;  ///< of the publication
    Tuple tuple;
    OutputCollector* collector;  ///< null: answered, or forgotten
  };
  ChannelSender(AckWhen ack_when, std::shared_ptr<SenderMeters> meters, std::shared_ptr<const Fence> fence)
      : ack_when_(ack_when), meters_(std::move(meters)), fence_(std::move(fence)) {}
  bool is_void(const Tuple& tuple) const;
  void pump(std::unique_lock<std::mutex>& lock);
  void on_outcome(std::uint64_t number, bool succeeded);
  void on_writable();

  /// Held back at most; more means that nobody limits the tuples under way, and fails.
  static constexpr std::size_t most_held = 100'000;

  const AckWhen ack_when_;
  const std::shared_ptr<SenderMeters> meters_;
  const std::shared_ptr<const Fence> fence_;
  std::mutex mutex_;
  std::condition_variable sent_;                   ///< sending_ or answering_ changed
  std::shared_ptr<brokers::Broker> broker_;        ///< guarded by mutex_; outlives the publisher
  std::shared_ptr<brokers::Publisher> publisher_;  ///< guarded by mutex_; null when closed
  std::deque<Held> held_;                          ///< guarded by mutex_
  std::deque<UnderWay> under_way_;                 ///< guarded by mutex_; by number
  std::uint64_t accepted_ = 0;                     ///< guarded by mutex_; number of the last publication
  std::vector<OutputCollector*> answering_;        ///< guarded by mutex_; whose tuples are being acked or failed
  bool full_ = false;                              ///< guarded by mutex_; until on_writable
  OutputCollector* sending_ = nullptr;             ///< guarded by mutex_; whose tuple a thread is sending
  bool writable_again_ = false;                    ///< guarded by mutex_; on_writable came while sending
};

}  // namespace iotcloud::topology
