#pragma once

#include <array>
#include <cstdint>
#include <string>

#include <amqp.h>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

inline constexpr amqp_channel_t publish_channel = 1;
/// For declarations. It is opened and closed for each, because a refusal closes the channel.
inline constexpr amqp_channel_t declare_channel = 2;

/// A topic without an exchange of its own uses the server's standard one.
inline const std::string& exchange_of(const Topic& topic) {
  static const std::string standard = "amq.direct";
  return topic.exchange.empty() ? standard : topic.exchange;
}

/// The type of durable topics' queues; others are always classic.
enum class QueueType {
  classic,  ///< on one node
  quorum,   ///< on a majority of the cluster's nodes: survives the loss of one
};

/// Quorum queues have no exclusive consumers: several readers get messages at once, and those of a hanging reader are
/// delivered later, out of order. So the queue itself picks one reader, and the others stand by.
inline bool one_reader_by_queue(const Topic& topic, QueueType type) {
  return topic.durable && type == QueueType::quorum;
}

/// The arguments of a topic's queue declaration. Must live until the request with table() is sent.
class QueueArguments {
 public:
  /// \param original a queue of the original system's programs, which has no arguments
  /// \param exclusive one reader at a time
  QueueArguments(const Topic& topic, bool original, QueueType type, bool exclusive) {
    if (original) return;
    if (!topic.durable) {
      amqp_table_entry_t& expires = add("x-expires", AMQP_FIELD_KIND_I32);
      expires.value.value.i32 = idle_ms;
    } else if (type == QueueType::quorum) {
      add("x-queue-type", AMQP_FIELD_KIND_UTF8).value.value.bytes = amqp_cstring_bytes("quorum");
      if (exclusive) add("x-single-active-consumer", AMQP_FIELD_KIND_BOOLEAN).value.value.boolean = 1;
    }
  }
  QueueArguments(const QueueArguments&) = delete;
  amqp_table_t table() { return {count_, count_ == 0 ? nullptr : entries_.data()}; }

 private:
  amqp_table_entry_t& add(const char* name, std::uint8_t kind) {
    amqp_table_entry_t& entry = entries_.at(static_cast<std::size_t>(count_++));
    entry.key = amqp_cstring_bytes(name);
    entry.value.kind = kind;
    return entry;
  }

  // A queue that is not durable outlives a reader's reconnection, but not the reader's end.
  static constexpr std::int32_t idle_ms = 60'000;
  int count_ = 0;
  std::array<amqp_table_entry_t, 2> entries_{};
};

/// The server's own exchanges exist already and must not be declared.
inline bool must_declare(const Topic& topic) {
  return !exchange_of(topic).starts_with("amq.");
}

}  // namespace iotcloud::brokers::rabbitmq
