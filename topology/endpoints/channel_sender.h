#pragma once

#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>

#include <iotcloud/brokers/broker.h>
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

/// Sends to one topic, in order, for all tasks of a bolt. A tuple is acked when the publisher has accepted its message;
/// while the publisher is full tuples are held back unacked, which stops the spout. What comes from before the fence
/// was put up is not sent: its tuple fails. Thread safe.
class ChannelSender : public std::enable_shared_from_this<ChannelSender> {
 public:
  static std::shared_ptr<ChannelSender> open(std::shared_ptr<brokers::Broker> broker, const brokers::Topic& topic,
                                             brokers::PublisherOptions options, std::shared_ptr<SenderMeters> meters,
                                             std::shared_ptr<const Fence> fence);

  /// Acks or fails the tuple, now or later.
  void send(brokers::Message message, const Tuple& tuple, OutputCollector& collector);
  /// What is held back does not time out meanwhile.
  void reset_timeouts();
  /// The collector goes: its tuples are forgotten. Returns when none of them is being sent.
  void forget(const OutputCollector& collector);
  /// Fails what is held back, closes the publisher.
  void close();

 private:
  struct Held {
    brokers::Message message;
    Tuple tuple;
    OutputCollector* collector;
  };
  ChannelSender(std::shared_ptr<SenderMeters> meters, std::shared_ptr<const Fence> fence)
      : meters_(std::move(meters)), fence_(std::move(fence)) {}
  bool is_void(const Tuple& tuple) const;
  void pump(std::unique_lock<std::mutex>& lock);
  void on_writable();

  /// Held back at most; more means that nobody limits the tuples under way, and fails.
  static constexpr std::size_t most_held = 100'000;

  const std::shared_ptr<SenderMeters> meters_;
  const std::shared_ptr<const Fence> fence_;
  std::mutex mutex_;
  std::condition_variable sent_;
  std::shared_ptr<brokers::Broker> broker_;        ///< guarded by mutex_; outlives the publisher
  std::shared_ptr<brokers::Publisher> publisher_;  ///< guarded by mutex_; null when closed
  std::deque<Held> held_;                          ///< guarded by mutex_
  bool full_ = false;                              ///< guarded by mutex_; until on_writable
  OutputCollector* sending_ = nullptr;             ///< guarded by mutex_; whose tuple a thread is sending
  bool writable_again_ = false;                    ///< guarded by mutex_; on_writable came while sending
};

}  // namespace iotcloud::topology
