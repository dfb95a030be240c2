#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

class MessageTraces;
class TopicReader;

/// The help text of iotcloud_spout_rejected_total, a counter that two classes use.
inline constexpr const char* rejected_help = "Messages given up after their last try, and rejected";

/// Counts a message as in its reader's hand (TopicReader::in_hand()) as long as it lives. Movable.
class HeldReader {
 public:
  /// \param bytes of the message
  explicit HeldReader(std::shared_ptr<TopicReader> reader, std::size_t bytes = 0);
  ~HeldReader();
  HeldReader(HeldReader&&) noexcept = default;
  HeldReader& operator=(HeldReader&& other) noexcept;
  TopicReader* operator->() const { return reader_.get(); }
  const std::shared_ptr<TopicReader>& shared() const { return reader_; }

 private:
  std::shared_ptr<TopicReader> reader_;  ///< null in a moved-from object
  std::size_t bytes_ = 0;
};

/// A message on its way from a channel into the topology.
struct ChannelMessage {
  ChannelMessage(brokers::Delivery received, std::shared_ptr<TopicReader> from)
      : reader(std::move(from), received.message.payload.size()), delivery(std::move(received)) {}

  HeldReader reader;
  /// Destroyed before `reader`: an unsettled message goes back to the broker before it leaves the reader's hand.
  brokers::Delivery delivery;
  int tries = 0;    ///< how often it was emitted
  int excused = 0;  ///< of these tries, those that failed for no fault of the message

  // For Retries:
  std::uint64_t sequence = 0;           ///< the order of the messages of one task
  config::Clock::Instant not_before{};  ///< when it may be emitted again
  bool blocks = false;                  ///< the later messages of its driver wait for it
};

/// The messages that wait for one spout task. A reader that fills the queue up to `limit` is paused until the queue is
/// half empty, so that a slow topology leaves messages in the broker. Thread safe.
class SpoutQueue {
 public:
  /// \param traces are told of each message while somebody asks for them; null: nobody ever does
  SpoutQueue(std::size_t limit, SpoutWaker waker, std::shared_ptr<MessageTraces> traces = nullptr)
      : limit_(limit), waker_(std::move(waker)), traces_(std::move(traces)) {}

  /// Adds a message and wakes the spout. A reader's handler calls it; if the spout is idle, it and the bolts run on the
  /// calling thread (SpoutWaker::wake()).
  void push(ChannelMessage arrival);
  struct Taken {
    std::optional<ChannelMessage> arrival;  ///< nullopt: the queue was empty
    bool more = false;                      ///< the queue has more messages
  };
  Taken pop();
  /// Drops the messages of a reader that was closed, which go back to its broker, and resumes other readers when there
  /// is room.
  void forget(const TopicReader& reader);
  /// Gives the messages that wait, and those that come from now on, back to the broker.
  void close();
  std::size_t size() const;

 private:
  void resume_when_half_empty() IOTCLOUD_REQUIRES(mutex_);

  const std::size_t limit_;
  const SpoutWaker waker_;
  const std::shared_ptr<MessageTraces> traces_;
  mutable config::Mutex mutex_;
  bool closed_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::deque<ChannelMessage> waiting_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<std::shared_ptr<TopicReader>> paused_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology
