#pragma once

namespace iotcloud::gateway {

/// The metric of a driver host that says for each broker whether it is away: the gateway reads it, too.
inline constexpr const char* broker_away_metric = "iotcloud_driver_broker_away";

}  // namespace iotcloud::gateway
