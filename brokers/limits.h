#pragma once

#include <cstddef>

#include <iotcloud/brokers/message.h>

namespace iotcloud::brokers {

/// The largest payload, in bytes: the default limit of a RabbitMQ server.
inline constexpr std::size_t max_payload = 134'217'728;
/// The longest name of a property, in bytes (AMQP's short strings).
inline constexpr std::size_t max_property_name = 255;
/// The limit of all metadata together, in bytes: they must fit into one AMQP frame.
inline constexpr std::size_t max_metadata = 120'000;

/// A message that arrives with more properties is skipped and counted as undecodable. A sender of ours has fewer,
/// because its metadata are limited; of a hostile one each further property would cost more time than the one before.
inline constexpr std::size_t max_received_properties = 8192;

/// Why no broker may take this message; nullptr if it may be sent. All brokers refuse the same messages.
const char* refusal(const Message& message);

}  // namespace iotcloud::brokers
