#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::brokers {

inline constexpr config::Logger logger{"brokers"};

}  // namespace iotcloud::brokers
