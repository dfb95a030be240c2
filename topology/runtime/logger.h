#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::topology {

inline constexpr config::Logger logger{"topology"};

}  // namespace iotcloud::topology
