#pragma once

#include <string>

#include <amqp.h>

#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

inline constexpr amqp_channel_t publish_channel = 1;
/// For declarations, opened and closed for each: a refusal closes the channel it came on.
inline constexpr amqp_channel_t declare_channel = 2;

/// A topic without an exchange of its own uses the server's standard one.
inline const std::string& exchange_of(const Topic& topic) {
  static const std::string standard = "amq.direct";
  return topic.exchange.empty() ? standard : topic.exchange;
}

/// Of durable topics' queues; the others are classic ones in any case.
enum class QueueType {
  classic,  ///< on one node
  quorum,   ///< on a majority of the cluster's nodes: survives the loss of one
};

/// What a topic's queues are declared with. Lives as long as the request that takes table() is being sent.
class QueueArguments {
 public:
  QueueArguments(const Topic& topic, QueueType type) {
    if (!topic.durable) {
      entry_.key = amqp_cstring_bytes("x-expires");
      entry_.value.kind = AMQP_FIELD_KIND_I32;
      entry_.value.value.i32 = idle_ms;
      count_ = 1;
    } else if (type == QueueType::quorum) {
      entry_.key = amqp_cstring_bytes("x-queue-type");
      entry_.value.kind = AMQP_FIELD_KIND_UTF8;
      entry_.value.value.bytes = amqp_cstring_bytes("quorum");
      count_ = 1;
    }
  }
  QueueArguments(const QueueArguments&) = delete;
  amqp_table_t table() { return {count_, count_ == 0 ? nullptr : &entry_}; }

 private:
  // A queue that is not durable outlives a reader that reconnects, but not one that is gone for good.
  static constexpr std::int32_t idle_ms = 60'000;
  int count_ = 0;
  amqp_table_entry_t entry_{};
};

/// The server's own exchanges are there already and must not be declared.
inline bool must_declare(const Topic& topic) {
  return !exchange_of(topic).starts_with("amq.");
}

}  // namespace iotcloud::brokers::rabbitmq
