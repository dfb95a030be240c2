#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::brokers::activemq {

inline constexpr config::Logger logger{"brokers.activemq"};

}  // namespace iotcloud::brokers::activemq
