#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::rpc {

inline constexpr config::Logger thrift_logger{"thrift"};

}  // namespace iotcloud::rpc
