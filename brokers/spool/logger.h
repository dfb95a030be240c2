#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::brokers::spool {

inline constexpr config::Logger logger{"brokers.spool"};

}  // namespace iotcloud::brokers::spool
