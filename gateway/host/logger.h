#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::gateway {

inline constexpr config::Logger host_logger{"gateway.host"};

}  // namespace iotcloud::gateway
