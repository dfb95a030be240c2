#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include <iotcloud/brokers/message.h>
#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/gateway/host/byte_fields.h>

namespace iotcloud::gateway {

/// A message of a shared channel on its way from the host that read it, through the gateway, to the host that runs its
/// instance.
struct PassedMessage {
  std::int64_t number = 0;   ///< names it in the answer; unique for the one who passes it
  std::string topic;         ///< the shared channel's wire name
  brokers::Message message;  ///< driver_id names the instance
  static constexpr const char* what = "a passed message";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(number, required),
                 IOTCLOUD_FIELD_IN(AsBase64, topic, required, "topic", topic),
                 IOTCLOUD_FIELD_IN(AsBase64, message.driver_id, required, "instance", instance),
                 IOTCLOUD_FIELD_IN(AsBase64, message.gateway_id, required, "gateway", gateway),
                 IOTCLOUD_FIELD_AS(message.time_ms, required, "time", time),
                 IOTCLOUD_FIELD_IN(AsBase64Pairs, message.properties, required, "properties", properties),
                 IOTCLOUD_FIELD_IN(AsBase64, message.payload, required, "payload", payload)};
};

/// The outcome of a passed message.
enum class PassAnswer {
  handled,  ///< the driver has handled it
  failed,   ///< the driver failed on it
  comes,    ///< no driver saw it; its instance is about to be open: pass it again a little later
  nowhere,  ///< no driver saw it; no host of this gateway runs its instance
};
/// The answer's word in JSON (discovery/description/json.h).
std::string json_value(PassAnswer answer);
/// Reads what json_value() wrote. \throws config::Error.
void parse(const std::string& name, PassAnswer& answer);

/// Why a message was not passed.
enum class NotPassed {
  gateway_away,  ///< there is no gateway now
  too_large,     ///< no frame to the gateway takes it
};

/// The size of a message on its way, in bytes: its payload, ids and properties.
inline std::size_t size_of(const brokers::Message& message) {
  constexpr std::size_t around_a_property = 64;  ///< what the encoding adds, rounded up
  std::size_t size = message.payload.size() + message.driver_id.size() + message.gateway_id.size();
  for (const auto& [key, value] : message.properties) size += key.size() + value.size() + around_a_property;
  return size;
}

/// How a host passes messages, and answers for those that are passed to it. Called on the host's threads; must not call
/// back into the host. Both may be empty: then nothing is passed.
struct Passing {
  /// \return null if the message was passed, and its answer follows
  std::function<std::optional<NotPassed>(const PassedMessage&)> pass{};
  std::function<void(std::int64_t number, PassAnswer)> answer{};
};

}  // namespace iotcloud::gateway
