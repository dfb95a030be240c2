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

/// What goes with a message beside its own metadata.
struct Envelope {
  std::string to;  ///< where it goes, see send_address()
  bool durable = false;
  bool resent = false;  ///< sent before, to a connection that was lost: possibly a duplicate
  std::uint8_t priority = 4;
  std::chrono::milliseconds expires_in{0};  ///< 0 = never
};

/// A message as JMS programs see it: a BytesMessage with the string properties sensorID, siteID, time and the custom
/// ones. JMS knows no order of properties, wants names that mean nothing to it, and strings of characters: the property
/// `iotcloud_properties` has the names in order, and both name and value of those that JMS would not carry unchanged.
///
/// Appends all of the message but its payload, which is to follow.
void write_head(const Message& message, const Envelope& envelope, std::string& out);

/// The bytes of a message that came, and who owns them.
struct WireBytes {
  std::shared_ptr<const void> owner;
  std::string_view text;
};

/// The message of whoever sent it; `redelivered` when it says so itself. Properties that are no strings are written as
/// text, nested ones are skipped; of a text message the body is the text. The payload shares the bytes.
/// \return nothing when the body is a map, a list or an object, or the bytes are no AMQP.
std::optional<client::Arrived> from_wire(const WireBytes& bytes);

}  // namespace iotcloud::brokers::activemq
