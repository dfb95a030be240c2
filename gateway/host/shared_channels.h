#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/gateway/host/channel_plan.h>
#include <iotcloud/gateway/host/channel_queue.h>
#include <iotcloud/gateway/host/event_loop.h>
#include <iotcloud/gateway/host/passed_message.h>

namespace iotcloud::gateway {

/// The shared incoming channels of one host: one subscription for each topic, whose messages go to the instance that
/// `driver_id` names, in order.
///
/// The broker lets one host at a time read a topic. A message for an instance that is not open here is passed to the
/// gateway's other hosts of the driver, one message of an instance at a time, so that their order holds. It is settled
/// at the broker when the driver there has handled it. The instances take turns. A message that is larger than what may
/// be passed now holds the turn until the others were answered.
///
/// A message whose instance is open nowhere waits for the instance. It waits for `longest_wait` at most if this host
/// was told to create the instance and it has not been failed for that long, if the gateway says that the instance is
/// about to be open, or if the gateway could not be asked yet; otherwise for `grace` at most. It never waits longer
/// than the channel's deadline, which counts from when the message first came to this host. After that the message is
/// dropped and counted, and so are later messages for that instance until the instance is open. While messages wait,
/// the broker keeps those that the subscription's prefetch does not take. Thread safe.
class SharedChannels {
 public:
  /// \param loop runs the timer that gives up messages; it is set only while messages wait. \param clock outlives this
  /// object, as the metrics do.
  SharedChannels(std::shared_ptr<EventLoop> loop, const config::Clock& clock, config::Metrics& metrics,
                 Passing passing = {});
  ~SharedChannels();

  /// The host was told to create this instance: its messages wait until it joins.
  void expect(const discovery::InstanceId& instance);
  /// The instance has failed: its messages wait for its restart.
  void failed(const discovery::InstanceId& instance);
  /// The instance has ended.
  void expect_no_more(const discovery::InstanceId& instance);

  /// Hands the channel's messages for this instance to the queue, first those that waited for it.
  void join(const PlannedChannel& channel, const std::shared_ptr<brokers::Broker>& broker,
            const discovery::InstanceId& instance, std::shared_ptr<ChannelQueue> queue);
  /// \param unhandled messages that the instance has not handled, in order; they wait for its return. When the last
  /// instance leaves, the subscription ends, and the broker gets back all that waits.
  void leave(const PlannedChannel& channel, const discovery::InstanceId& instance,
             std::deque<ChannelQueue::Waiting> unhandled);

  /// Takes a message that another host has passed; Passing::answer says what became of it.
  void take(PassedMessage passed);
  /// Reports the outcome of a message that was passed from here.
  void answered(std::int64_t number, PassAnswer answer);
  /// No answer follows to what was passed: it waits here again.
  void nobody_answers();

  static constexpr std::chrono::seconds grace{5};
  static constexpr std::chrono::seconds longest_wait{60};

 private:
  struct Hub;
  struct Common;
  class Answerer;
  using Key = std::pair<std::string, std::string>;  ///< broker URL, topic name
  static Key key_of(const PlannedChannel& channel) { return {channel.record.broker_url, channel.topic.name}; }

  std::vector<std::shared_ptr<Hub>> hubs() const IOTCLOUD_EXCLUDES(mutex_);

  const std::shared_ptr<EventLoop> loop_;
  const config::Clock& clock_;
  config::Metrics& metrics_;
  const std::shared_ptr<Common> common_;
  mutable config::Mutex mutex_;
  std::map<Key, std::shared_ptr<Hub>> hubs_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::gateway
