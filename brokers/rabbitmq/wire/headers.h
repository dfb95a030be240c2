#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <amqp.h>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// Identifies a message, however often it is sent: the AMQP property message-id, `<publisher, 16 hex digits>-<number>`.
struct MessageOrigin {
  std::uint64_t publisher = 0;  ///< Outbox::id
  std::uint64_t number = 0;     ///< ascending for each publisher
  bool operator==(const MessageOrigin&) const = default;
};

/// Encodes the AMQP properties of one message (docs/wire.md#message-metadata).
/// The result points into this object and into the message, which both must outlive its use. Reuse one object for many
/// messages.
class MessageProperties {
 public:
  struct SendOptions {
    bool durable = false;
    bool resent = false;                      ///< sent before on a connection that was lost, so possibly a duplicate
    std::chrono::milliseconds expires_in{0};  ///< 0: never
    std::uint8_t priority = normal_priority;
    MessageOrigin origin;
  };
  const amqp_basic_properties_t& encode(const Message& message, const SendOptions& options);

 private:
  /// A number in decimal digits.
  class Digits {
   public:
    amqp_bytes_t of(std::int64_t number);

   private:
    std::array<char, 24> text_{};
  };
  void add(amqp_bytes_t name, amqp_bytes_t value);

  amqp_basic_properties_t properties_{};
  std::vector<amqp_table_entry_t> entries_;
  Digits time_, expiration_;
  std::array<char, 40> message_id_{};
};

/// Fills the message's metadata from the properties of any publisher. Values that are not strings become text, nested
/// tables and arrays are skipped. \return whether the message is marked as sent before (see `resent`).
bool decode_properties(const amqp_basic_properties_t& properties, Message& message);

/// nullopt: another program published it.
std::optional<MessageOrigin> origin_of(const amqp_basic_properties_t& properties);

}  // namespace iotcloud::brokers::rabbitmq
