#pragma once

#include <cstddef>

#include <iotcloud/brokers/message.h>

namespace iotcloud::brokers {

/// The largest payload, in bytes: what a RabbitMQ server takes unless it is configured otherwise.
inline constexpr std::size_t max_payload = 134'217'728;
/// The longest name of a property, in bytes (AMQP's short strings).
inline constexpr std::size_t max_property_name = 255;
/// All metadata together, in bytes: they must fit into one AMQP frame.
inline constexpr std::size_t max_metadata = 120'000;

/// Why no broker may take this message; nullptr when it may be sent. All brokers refuse the same.
const char* refusal(const Message& message);

}  // namespace iotcloud::brokers
