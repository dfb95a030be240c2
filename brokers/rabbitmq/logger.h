#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::brokers::rabbitmq {

inline constexpr config::Logger logger{"brokers.rabbitmq"};

}  // namespace iotcloud::brokers::rabbitmq
