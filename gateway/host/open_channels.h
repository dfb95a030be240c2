#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/host/channel_looks.h>
#include <iotcloud/gateway/host/channel_plan.h>
#include <iotcloud/gateway/host/channel_queue.h>
#include <iotcloud/gateway/host/host_environment.h>
#include <iotcloud/gateway/host/outgoing_channel.h>

namespace iotcloud::gateway {

/// The open channels of one driver instance. The driver publishes on them; people look at them, and send the driver
/// messages by hand. The instance's event thread opens and closes them. Thread safe.
class OpenChannels {
 public:
  using Outgoing = std::map<std::string, std::unique_ptr<OutgoingChannel>, std::less<>>;

  /// \param environment outlives this object. \param id the instance's
  OpenChannels(const HostEnvironment& environment, discovery::InstanceId id)
      : environment_(environment), id_(std::move(id)) {}

  void add_outgoing(const PlannedChannel& channel, std::unique_ptr<OutgoingChannel> outgoing);
  void add_incoming(const PlannedChannel& channel, std::shared_ptr<brokers::Broker> broker,
                    std::shared_ptr<ChannelQueue> queue, std::shared_ptr<ChannelLooks> looks);
  /// From now on people find no channel. The driver may publish still.
  void hide();
  /// Removes all channels. Returns the outgoing ones when no call of publish() runs any more.
  Outgoing take_outgoing();

  /// Sends on an outgoing channel. \return nullopt: there is none of that name, and the message is left as it is
  std::optional<drivers::PublishStatus> publish(std::string_view channel, drivers::Message& message);
  std::vector<std::string> outgoing_names() const;

  /// Calls `use` for each channel.
  void each_backlog(
      const std::function<void(const discovery::ChannelRecord&, const ChannelQueue::Backlog&)>& use) const;
  void each_tally(const std::function<void(const discovery::ChannelRecord&, const ChannelTally&)>& use) const;
  /// Answers a question about all channels, and about the one that it names if it names one. \param answer has the
  /// instance's state already
  void look(const discovery::LookRequest& request, discovery::ChannelLook& answer) const;
  /// Puts a message into the queue of an incoming channel. \param done gets the outcome, once, on any thread: why the
  /// driver did not handle the message; empty: it did
  void hand(const std::string& channel, brokers::Message message,
            const std::function<void(const std::string& problem)>& done);

 private:
  struct OpenChannel {
    discovery::ChannelRecord record;
    std::shared_ptr<brokers::Broker> broker;
    std::shared_ptr<ChannelQueue> queue{};  ///< of an incoming channel
    std::shared_ptr<ChannelLooks> looks{};  ///< of an incoming channel
  };
  std::vector<discovery::ChannelState> states() const IOTCLOUD_REQUIRES_SHARED(mutex_);
  ChannelQueue::Backlog backlog_of(const std::string& name, const OpenChannel& channel) const
      IOTCLOUD_REQUIRES_SHARED(mutex_);
  const ChannelTally* tally_of(const std::string& name, const OpenChannel& channel) const
      IOTCLOUD_REQUIRES_SHARED(mutex_);
  std::string unknown(const std::string& name) const IOTCLOUD_REQUIRES_SHARED(mutex_);

  const HostEnvironment& environment_;
  const discovery::InstanceId id_;
  mutable config::SharedMutex mutex_;
  Outgoing outgoing_ IOTCLOUD_GUARDED_BY(mutex_);
  /// All that people find, also the outgoing ones.
  std::map<std::string, OpenChannel, std::less<>> channels_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::gateway
