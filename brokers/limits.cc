#include "iotcloud/brokers/limits.h"

namespace iotcloud::brokers {

const char* refusal(const Message& message) {
  if (message.payload.size() > max_payload) return "too_large";
  constexpr std::size_t overhead = 16;  // most bytes for each entry on the wire
  std::size_t metadata = message.driver_id.size() + message.gateway_id.size() + 8 * overhead;
  for (const auto& [name, value] : message.properties) {
    if (name.size() > max_property_name) return "property_name_too_long";
    metadata += name.size() + value.size() + overhead;
  }
  return metadata > max_metadata ? "properties_too_large" : nullptr;
}

}  // namespace iotcloud::brokers
