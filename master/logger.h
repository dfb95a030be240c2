#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::master {

inline constexpr config::Logger logger{"master"};

}  // namespace iotcloud::master
