#pragma once

#include <cstdint>
#include <string>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/ids.h>

namespace iotcloud::gateway {

/// A channel of an instance whose messages are being lost now.
struct LosingChannel {
  discovery::InstanceId instance;
  std::string channel;
  std::string fate;           ///< what becomes of the messages: "dropped: superseded"
  std::int64_t since_ms = 0;  ///< wall time
  static constexpr const char* what = "a channel that loses messages";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(instance, required), IOTCLOUD_FIELD(channel, required), IOTCLOUD_FIELD(fate, required),
                 IOTCLOUD_FIELD_AS(since_ms, required, "since_ms", sinceMs)};
  friend bool operator==(const LosingChannel&, const LosingChannel&) = default;
};

}  // namespace iotcloud::gateway
