#pragma once

#include <string>
#include <vector>

#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/drivers/driver.h>
#include <iotcloud/gateway/host/instance_spec.h>

namespace iotcloud::gateway {

/// One channel with its final settings: its quality of service after the deployment's overrides, its names and its
/// broker.
struct PlannedChannel {
  drivers::ChannelSpec spec;
  brokers::Topic topic;
  brokers::BrokerAddress address;
  /// Outgoing channels: publish to the topic's own queue too, which topologies of the original system read.
  bool own_queue = false;
  /// With `interop: java` on RabbitMQ: the queue that the original's programs declare too, see brokers/broker.h.
  std::string original_queue;
  brokers::BrokerOptions broker;    ///< how to connect to the broker
  discovery::ChannelRecord record;  ///< the channel's record in the registry
};

/// Makes the plan of the channels that a driver asked for: applies "channel.<name>.<option>" properties of the
/// deployment, picks the broker, and fills the channel's record, from which the wire name comes
/// (discovery/channel_names.h). The exchange defaults to the broker's property `exchange`, or else the driver's name; a
/// durable channel's to
/// `<driver>.durable`, because one exchange cannot be both.
/// \throws config::Error that names the invalid channel or property.
std::vector<PlannedChannel> plan_channels(const discovery::GatewayId& gateway, const discovery::DriverName& driver,
                                          const InstanceSpec& instance, std::vector<drivers::ChannelSpec> wanted);

}  // namespace iotcloud::gateway
