#pragma once

#include <cstddef>
#include <string>

namespace iotcloud::processes {

/// A piece of a rotated log (LogFile).
struct LogExcerpt {
  std::string text;      ///< complete lines, unless one line is longer than the requested size
  std::string position;  ///< where to go on; opaque
};

/// Reads a log and its older files. Reading on from a position misses nothing as long as the file of that position is
/// kept; otherwise it goes on with the oldest file. \param path the current log file. \param position
/// LogExcerpt::position of an earlier call; empty: the last `most` bytes of the log. \param most limit in bytes; more
/// than 0.
/// \throws config::Error if there is no such log, or the position is malformed.
LogExcerpt read_log(const std::string& path, const std::string& position, std::size_t most);

}  // namespace iotcloud::processes
