#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/host/channel_tally.h>
#include <iotcloud/gateway/host/event_loop.h>

namespace iotcloud::gateway {

/// The help text of iotcloud_driver_lost_total, a counter that two classes use.
inline constexpr const char* lost_help = "Received messages that no driver handled, by reason";

/// Messages of one incoming channel of one instance, on their way from the broker's thread to the instance's event
/// thread. The subscription's prefetch limits the queue's length; with `keep_last` the queue drops its oldest messages.
/// Thread safe.
class ChannelQueue : public std::enable_shared_from_this<ChannelQueue> {
 public:
  /// The outcome of a message that was to be delivered.
  enum class Handled {
    done,       ///< the driver has handled it
    failed,     ///< the driver failed on it
    not_taken,  ///< the instance has ended, and the driver did not see it
  };
  struct Waiting {
    brokers::Delivery delivery;
    config::Clock::Instant since{};  ///< when it came to this host
    std::uint64_t place = 0;         ///< its place in the order in which the messages came; read likewise
    bool passed = false;             ///< another host has passed it to this one
  };
  /// Runs on the loop, one message at a time. Moves from the message unless it returns `not_taken`. `since` is
  /// Waiting::since.
  using Deliver = std::function<Handled(brokers::Message&&, config::Clock::Instant since)>;
  ChannelQueue(std::shared_ptr<EventLoop> loop, std::size_t keep_last, config::Counter& superseded, Deliver deliver);

  /// Queues a delivery. It is accepted when the driver has handled it, and rejected if the driver failed on it.
  /// \return the delivery after close(), nothing before
  std::optional<Waiting> push(Waiting waiting);
  /// How many messages wait, and for how long the first of them.
  struct Backlog {
    std::size_t waiting = 0;
    std::chrono::milliseconds oldest{0};
  };
  Backlog backlog(config::Clock::Instant now) const;
  /// What became of the messages.
  const ChannelTally& tally() const { return tally_; }
  /// Ends the delivery. To be called on the loop's thread. \return the messages that the driver did not see, in order,
  /// without those that were passed, which go back
  std::deque<Waiting> close();

 private:
  void drain();

  const std::shared_ptr<EventLoop> loop_;
  const std::size_t keep_last_;
  config::Counter& superseded_;
  const Deliver deliver_;
  ChannelTally tally_;
  mutable config::Mutex mutex_;
  std::deque<Waiting> waiting_ IOTCLOUD_GUARDED_BY(mutex_);
  bool scheduled_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool closed_ IOTCLOUD_GUARDED_BY(mutex_) = false;
};

}  // namespace iotcloud::gateway
