#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "iotcloud/brokers/client/ack_window.h"
#include <iotcloud/brokers/message.h>

namespace iotcloud::brokers::activemq {

/// The fields of the wire message besides the message's own metadata.
struct Envelope {
  std::string to;  ///< the address, see send_address()
  bool durable = false;
  bool resent = false;  ///< sent before on a connection that was lost, so possibly a duplicate
  std::uint8_t priority = 4;
  std::chrono::milliseconds expires_in{0};  ///< 0: never
};

/// Encodes a message as JMS programs see it: a BytesMessage with the string properties sensorID, siteID, time and the
/// custom ones. JMS keeps no order of properties, and some names and values do not pass through it unchanged. So the
/// property `iotcloud_properties` lists the names in order, with both name and value of properties that JMS would
/// change.
///
/// Appends the whole message except its payload, which the caller appends.
void write_head(const Message& message, const Envelope& envelope, std::string& out);

/// The bytes of a received message, and their owner.
struct WireBytes {
  std::shared_ptr<const void> owner;
  std::string_view text;
};

/// Decodes a message of any sender; `redelivered` is what the message says itself. Properties that are not strings
/// become text, nested ones are skipped; the text of a text message becomes the payload. The payload shares the bytes.
/// \return nothing when the body is a map, a list or an object, or when the bytes are not AMQP.
std::optional<client::Arrived> from_wire(const WireBytes& bytes);

}  // namespace iotcloud::brokers::activemq
