#pragma once

#include <string>

#include <iotcloud/discovery/records.h>

namespace iotcloud::discovery {

/// The prefix of a channel's names on the wire (docs/wire.md#topics): "<gateway>.<driver>.<instance>.", or of a
/// shared channel "<gateway>.<driver>.".
std::string wire_prefix(const ChannelRecord& channel);

/// Whether the channel is on Kafka: its URL says so, or has no scheme beside a property `topic`, as the original's
/// gateways write Kafka's servers.
bool is_on_kafka(const ChannelRecord& channel);

/// The channel's topic at its broker: its prefix and, on Kafka, its property `topic`, elsewhere `routingKey`, or else
/// `queueName`; a driver may give all of them. A record that lacks these may have one of the others. Older gateways of
/// this project wrote whole wire names into these properties, beside `durable`, which the original does not write: such
/// a name is taken as it is. Empty: the record names no topic.
std::string wire_name(const ChannelRecord& channel);

/// The one queue that the original's programs read and declare on RabbitMQ: as wire_name(), from `queueName` first.
std::string original_queue(const ChannelRecord& channel);

}  // namespace iotcloud::discovery
