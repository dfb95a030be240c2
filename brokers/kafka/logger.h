#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::brokers::kafka {

inline constexpr config::Logger logger{"brokers.kafka"};

}  // namespace iotcloud::brokers::kafka
