#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/fence.h>

namespace iotcloud::topology {

/// What the endpoints of a worker share. Filled by the worker before the topology starts, constant from then on.
struct EndpointServices {
  std::string topology;                     ///< name: the group that reads, where the spout names no other
  std::string worker;                       ///< this worker's name below Paths::workers(topology)
  discovery::Registry* registry = nullptr;  ///< outlives the topology's run
  discovery::Paths paths;
  /// By logical name: how to connect. URLs, when there are some, go before those of the channels.
  std::map<std::string, brokers::BrokerOptions> broker_options;
  brokers::BrokerOptions other_brokers;  ///< how to connect to those that broker_options does not name
  std::shared_ptr<brokers::BrokerPool> brokers;
  const config::Clock* clock = nullptr;
  config::Metrics* metrics = nullptr;
  std::shared_ptr<Fence> fence = std::make_shared<Fence>();  ///< never null
  std::vector<std::function<void()>> before_stop;            ///< the worker calls them before it stops the topology
  std::vector<std::function<void()>> after_stop;             ///< and when it has left the registry
};
using EndpointServicesPtr = std::shared_ptr<EndpointServices>;

/// Where a channel's messages are.
brokers::Topic topic_of(const discovery::ChannelRecord& channel);
brokers::BrokerAddress address_of(const discovery::ChannelRecord& channel, const EndpointServices& services);
/// Who reads together: what the broker knows the readers by.
const std::string& group_of(const EndpointDefinition& endpoint, const EndpointServices& services);
/// Where the records of those readers are.
std::string readers_path(const EndpointDefinition& endpoint, const EndpointServices& services);
/// The channel's priority, as its driver says.
std::uint8_t priority_of(const discovery::ChannelRecord& channel);
/// The broker of an address. \throws config::Error when it cannot be used.
std::shared_ptr<brokers::Broker> broker_at(const brokers::BrokerAddress& address, const EndpointServices& services);

}  // namespace iotcloud::topology
