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

/// The server's own exchanges are there already and must not be declared.
inline bool must_declare(const Topic& topic) {
  return !exchange_of(topic).starts_with("amq.");
}

}  // namespace iotcloud::brokers::rabbitmq
