#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include <iotcloud/brokers/message.h>

namespace iotcloud::brokers {

/// An encoded message. Its bytes are not cleared before they are written.
struct EnvelopeBytes {
  std::unique_ptr<std::byte[]> data;
  std::size_t size = 0;
};

/// The message as a TSensorMessage in Thrift's binary protocol (envelope.thrift), byte for byte what Thrift's own code
/// writes; `time_ms` travels as the property "time". One copy of the body.
EnvelopeBytes encode_envelope(const Message& message);

/// A message whose body still lies in the bytes it was read from.
struct OpenedEnvelope {
  Message message;  ///< without its payload
  std::span<const std::byte> body;
  std::optional<std::int64_t> time_ms;  ///< nothing when the sender gave none, or none that is a number
};

/// Reads a TSensorMessage, whoever wrote it: unknown fields are skipped, as are missing ones. \return nothing for bytes
/// that are none: wrong types, lengths or container sizes, nesting without end, truncated. Needs memory for what is
/// there only, whatever the bytes say. Never throws, `std::bad_alloc` apart.
std::optional<OpenedEnvelope> open_envelope(std::span<const std::byte> bytes);

}  // namespace iotcloud::brokers
