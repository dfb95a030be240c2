#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::gateway {

inline constexpr config::Logger logger{"gateway"};

}  // namespace iotcloud::gateway
