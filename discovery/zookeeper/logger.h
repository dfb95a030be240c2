#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::discovery::zookeeper {

inline constexpr config::Logger logger{"discovery.zookeeper"};

}  // namespace iotcloud::discovery::zookeeper
