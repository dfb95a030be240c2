#pragma once

#include <iotcloud/config/log.h>

namespace iotcloud::security {

inline constexpr config::Logger access_logger{"access"};
inline constexpr config::Logger certificates_logger{"certificates"};
inline constexpr config::Logger keys_logger{"keys"};

}  // namespace iotcloud::security
