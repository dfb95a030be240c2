#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>

#include <iotcloud/topology/endpoints/receiving/inbox.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// Where a spout component's messages go when they are given up: published to one durable topic, on the broker that
/// they came from, with headers that say why; the original is accepted only when the broker has confirmed it. So a
/// message is in at least one of the two queues at any time; in both when the worker ends in between.
/// Thread safe; shared by the component's tasks.
class DeadLetters {
 public:
  DeadLetters(EndpointServicesPtr services, std::string component, std::string topic);
  ~DeadLetters();

  /// Settles the message when the broker has answered: accepted, or rejected when the broker refuses the letter.
  void send(Arrival arrival);
  /// Waits until the brokers have answered for everything, `limit` at most.
  void drain(std::chrono::milliseconds limit);

 private:
  struct Sender;

  const EndpointServicesPtr services_;
  const std::string component_;
  const std::string topic_;
  std::mutex mutex_;
  std::map<brokers::BrokerAddress, std::shared_ptr<Sender>> senders_;  ///< guarded by mutex_
};

}  // namespace iotcloud::topology
