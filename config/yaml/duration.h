#pragma once

#include <chrono>
#include <string>

namespace iotcloud::config::internal {

/// Writes a duration as parse_duration() (yaml.h) reads it, in the largest unit that gives a whole number: "250ms",
/// "10s".
std::string duration_text(std::chrono::microseconds time);

}  // namespace iotcloud::config::internal
