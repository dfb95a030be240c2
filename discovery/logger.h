#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::discovery {

inline constexpr config::Logger logger{"discovery"};

}  // namespace iotcloud::discovery
