#pragma once

#include <string>
#include <vector>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/gateway/host/instance_spec.h>

namespace iotcloud::gateway {

/// One channel, decided: its quality of service after the deployment's overrides, its names and its broker.
struct PlannedChannel {
  drivers::ChannelSpec spec;
  brokers::Topic topic;
  brokers::BrokerAddress address;
  bool own_queue = false;           ///< out: also into the topic's own queue, which topologies of the original read
  brokers::BrokerOptions broker;    ///< how to connect to it
  discovery::ChannelRecord record;  ///< as it goes into the registry
};

/// Decides the channels that a driver asked for: applies "channel.<name>.<option>" properties of the deployment, picks
/// the broker, and makes the wire names of REFERENCE.md 3 (`gateway.driver.instance.queue`, shared:
/// `gateway.driver.queue`). The exchange defaults to the driver's name; a durable channel's to `<driver>.durable`,
/// because one exchange cannot be both.
/// \throws config::Error naming the channel or property that cannot be.
std::vector<PlannedChannel> plan_channels(const std::string& gateway, const std::string& driver,
                                          const InstanceSpec& instance, std::vector<drivers::ChannelSpec> wanted);

}  // namespace iotcloud::gateway
