#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include <iotcloud/gateway/host/channel_looks.h>
#include <iotcloud/gateway/host/channel_plan.h>
#include <iotcloud/gateway/host/channel_tally.h>
#include <iotcloud/gateway/host/host_environment.h>

namespace iotcloud::gateway {

/// A channel on which one instance sends: its publisher, a spool on disk if the channel asks for one, and metrics of
/// the messages' outcomes. Thread safe are only those functions that say so.
class OutgoingChannel {
 public:
  /// Called on threads of the broker client or of the spool.
  struct Events {
    std::function<void()> on_writable;             ///< the channel takes messages again after `would_block`
    std::function<void(std::uint64_t)> on_stored;  ///< how many accepted messages are on the disk
  };
  /// \throws config::Error if the channel cannot be opened, or needs a spool and the host has no state folder.
  OutgoingChannel(const HostEnvironment& environment, discovery::InstanceId instance, const PlannedChannel& channel,
                  Events events);
  /// Calls close().
  ~OutgoingChannel();

  /// Thread safe.
  drivers::PublishStatus publish(drivers::Message message);
  /// The messages that wait to be confirmed. Thread safe.
  ChannelQueue::Backlog backlog() const;
  /// What became of the messages. Thread safe.
  const ChannelTally& tally() const;
  /// The looks at what is published here. Thread safe.
  ChannelLooks& looks() { return looks_; }
  /// Whether unsent messages stay on disk until the channel is opened for this instance again.
  bool spooled() const { return !spool_folder_.empty(); }
  /// Waits until every accepted message has an outcome, at most `limit`.
  void drain(std::chrono::milliseconds limit);
  /// Closes the publisher and logs unconfirmed messages; spooled ones stay on the disk. Further calls do nothing.
  void close();

 private:
  class OutcomeCounters;

  drivers::PublishStatus pass_on(drivers::Message message, std::uint64_t& number);

  const discovery::InstanceId instance_;
  const std::string name_;
  const config::Clock& clock_;
  ChannelLooks looks_;
  std::string spool_folder_;  ///< empty: the channel has no spool
  std::shared_ptr<OutcomeCounters> counters_;
  std::shared_ptr<brokers::Broker> broker_;        ///< declared before the publisher, which uses it
  std::unique_ptr<brokers::Publisher> publisher_;  ///< null: the channel is closed
};

}  // namespace iotcloud::gateway
