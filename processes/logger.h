#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::processes {

inline constexpr config::Logger logger{"processes"};

}  // namespace iotcloud::processes
