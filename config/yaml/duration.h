#pragma once

#include <chrono>
#include <string>

namespace iotcloud::config::internal {

/// As parse_duration() (yaml.h) reads it, in the largest unit that leaves a whole number: "250ms", "10s".
std::string duration_text(std::chrono::microseconds time);

}  // namespace iotcloud::config::internal
