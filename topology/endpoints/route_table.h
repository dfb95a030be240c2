#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <utility>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/channel_sender.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {

/// Knows the way to every instance of a driver that has the channel, as they come and go; shared by all tasks of one
/// bolt in a worker. Thread safe.
class RouteTable {
 public:
  RouteTable(EndpointServicesPtr services, std::string component, EndpointDefinition endpoint);

  /// The first task begins the search for drivers.
  void join();
  /// A task's collector goes; with the last one the search ends.
  void leave(const OutputCollector& collector);

  struct Route {
    std::shared_ptr<ChannelSender> sender;
    std::string gateway;
  };
  /// No sender: no driver of this id has the channel.
  Route find(const std::string& driver_id) const;
  /// See ChannelSender::reset_timeouts.
  void reset_timeouts();

 private:
  using SenderKey = std::pair<std::string, brokers::Topic>;  ///< URL and topic

  void on_channel(const discovery::ChannelRecord& channel);
  void on_channel_gone(const discovery::ChannelRecord& channel);
  bool fits(const discovery::ChannelRecord& channel);
  std::shared_ptr<ChannelSender> sender_for(const discovery::ChannelRecord& channel);

  const EndpointServicesPtr services_;
  const std::string component_;
  const EndpointDefinition endpoint_;

  std::mutex joining_;  ///< taken before mutex_, never by callbacks
  int tasks_ = 0;       ///< guarded by joining_
  mutable std::mutex mutex_;
  std::shared_ptr<SenderMeters> meters_;                       ///< guarded by mutex_
  std::map<std::string, Route> routes_;                        ///< by driver instance; guarded by mutex_
  std::map<SenderKey, std::weak_ptr<ChannelSender>> senders_;  ///< guarded by mutex_
  std::set<std::string> complained_;                           ///< guarded by mutex_
  std::unique_ptr<discovery::DriverDirectory> directory_;      ///< guarded by joining_
};

}  // namespace iotcloud::topology
