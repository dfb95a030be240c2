#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::topology {

inline constexpr config::Logger endpoints_logger{"topology.endpoints"};

}  // namespace iotcloud::topology
