#pragma once

#include <map>
#include <memory>
#include <string>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/endpoints/receiving/spout_queue.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// Publishes the messages that a spout component gives up to one durable topic, on the broker that they came from, with
/// headers that say why. The original message is accepted only when the broker has confirmed the published one. So a
/// message is in at least one of the two queues at any time, and in both when the worker ends in between.
/// All tasks of the component share one object. Thread safe.
class DeadLetterSender {
 public:
  DeadLetterSender(EndpointServicesPtr services, std::string component, std::string topic);
  ~DeadLetterSender();

  /// Publishes the message as a dead letter. Settles the message when the broker has answered: accepts it when the
  /// letter is confirmed, rejects it when the broker refuses the letter.
  /// \param reason why the message is given up: a header of the letter.
  void send(ChannelMessage arrival, const std::string& reason);
  /// Waits until the brokers have answered for all letters, `limit` at most.
  void drain(std::chrono::milliseconds limit);

 private:
  struct Sender;

  const EndpointServicesPtr services_;
  const std::string component_;
  const std::string topic_;
  config::Mutex mutex_;
  std::map<brokers::BrokerAddress, std::shared_ptr<Sender>> senders_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology
