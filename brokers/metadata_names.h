#pragma once

#include <string_view>

/// The original system's names for a message's metadata, so that its programs and ours read each other's messages
/// (docs/wire.md#message-metadata).
namespace iotcloud::brokers::metadata {

inline constexpr std::string_view driver = "sensorID";
inline constexpr std::string_view gateway = "siteID";
inline constexpr std::string_view time = "time";

/// Whether a custom property of that name would be taken for metadata.
constexpr bool is_original(std::string_view name) {
  return name == driver || name == gateway || name == time;
}

/// Only in this project, on brokers with headers: this copy was sent before, on a connection that was lost.
inline constexpr std::string_view resent_header = "x-iotcloud-resent";

}  // namespace iotcloud::brokers::metadata
