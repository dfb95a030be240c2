#pragma once

#include <cstddef>
#include <string>

namespace iotcloud::gateway {

/// A piece of a log that is moved away when it has grown (LogFile).
struct LogPart {
  std::string text;      ///< whole lines, unless one is longer than what was asked for
  std::string position;  ///< where to go on; opaque
};

/// Reads a log and the older ones beside it. Going on at a position misses nothing as long as the file it is in is
/// kept; after that reading goes on with the oldest that there is. \param path of the log that is written now. \param
/// position of an earlier part; empty: the end of the log, `most` bytes of it. \param most bytes at most; more than 0.
/// \throws config::Error when there is no such log, or the position is none.
LogPart read_log(const std::string& path, const std::string& position, std::size_t most);

}  // namespace iotcloud::gateway
