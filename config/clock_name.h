#pragma once

#include <string>

namespace iotcloud::config {

/// Names what system_clock().now() counts from: this start of the machine. Processes with the same name have the same
/// clock, so that they may compare their times. Empty if the machine does not tell. Thread safe.
const std::string& system_clock_name();

}  // namespace iotcloud::config
