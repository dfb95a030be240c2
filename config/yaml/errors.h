#pragma once

#include <vector>

#include <iotcloud/config/error.h>

namespace iotcloud::config {

/// Several errors as one: its text has a line for each. A single error stays as it is. \pre there is one.
ConfigError together(const std::vector<ConfigError>& errors);

}  // namespace iotcloud::config
