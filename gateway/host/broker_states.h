#pragma once

#include <cstdint>
#include <string>

#include <iotcloud/discovery/description/fields.h>

namespace iotcloud::gateway {

/// The metric of a driver host that says for each broker whether it is away.
inline constexpr const char* broker_away_metric = "iotcloud_driver_broker_away";

/// A broker that a driver host uses.
struct BrokerLink {
  std::string broker;         ///< its logical name
  std::string url;            ///< printable, of the preferred server
  std::string state;          ///< "connected", "away", or "takes no messages"
  std::int64_t since_ms = 0;  ///< wall time of the first look that found it so
  std::string why;            ///< Broker::problem()
  static constexpr const char* what = "a broker of a driver host";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD(broker, required), IOTCLOUD_FIELD(url, required), IOTCLOUD_FIELD(state, required),
                 IOTCLOUD_FIELD_AS(since_ms, required, "since_ms", sinceMs), IOTCLOUD_FIELD(why, usual)};
  friend bool operator==(const BrokerLink&, const BrokerLink&) = default;
};

}  // namespace iotcloud::gateway
