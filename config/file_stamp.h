#pragma once

#include <array>
#include <cstdint>
#include <string>

namespace iotcloud::config {

/// Tells one version of a file from the next: its device, its number there, its size in bytes, and when its content and
/// its state changed, in nanoseconds since 1970 UTC. All zero: the file is missing, or cannot be reached.
using FileStamp = std::array<std::int64_t, 5>;

/// The stamp of the file now. Thread safe.
FileStamp stamp_of(const std::string& file);

}  // namespace iotcloud::config
