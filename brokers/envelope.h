#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include <iotcloud/brokers/message.h>

namespace iotcloud::brokers {

/// An encoded message, in memory that is not cleared before it is written.
struct EnvelopeBytes {
  std::unique_ptr<std::byte[]> data;
  std::size_t size = 0;
};

/// The message as a TSensorMessage in Thrift's binary protocol (envelope.thrift), byte for byte what Thrift's own code
/// writes; `time_ms` travels as the property "time". One copy of the body.
EnvelopeBytes encode_envelope(const Message& message);

/// A message whose body is still in the bytes that it was read from.
struct OpenedEnvelope {
  Message message;  ///< without its payload
  std::span<const std::byte> body;
  std::optional<std::int64_t> time_ms;  ///< nothing if the sender set no time, or one that is not a number
};

/// Reads any TSensorMessage; skips unknown fields and accepts missing ones. \return nothing for other bytes: wrong
/// types, lengths or container sizes, endless nesting, truncation. Allocates memory only for what the bytes contain,
/// whatever they claim. Throws nothing but `std::bad_alloc`.
std::optional<OpenedEnvelope> open_envelope(std::span<const std::byte> bytes);

}  // namespace iotcloud::brokers
