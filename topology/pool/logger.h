#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::topology {

inline constexpr config::Logger pool_logger{"topology.pool"};

}  // namespace iotcloud::topology
