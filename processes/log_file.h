#pragma once

#include <cstdint>
#include <string>

namespace iotcloud::processes {

/// Rotates the file to which this process's stdout and stderr go: when it exceeds the limit it becomes `<path>.1`, the
/// former `<path>.1` becomes `<path>.2` and so on, and a new file is begun. No line is lost. Several processes may
/// write to one file: one of them rotates it, and the others switch to the new file. Used on one thread.
class LogFile {
 public:
  struct Options {
    std::string path;  ///< empty: there is no log, and rotate_if_too_long() does nothing
    std::uint64_t most_bytes = std::uint64_t{10} << 20;
    int kept = 3;  ///< number of older files that are kept besides the current one
  };
  explicit LogFile(Options options) : options_(std::move(options)) {}

  /// Rotates the file if it is too long, or switches to the new file if another process rotated it. Call it every few
  /// seconds.
  void rotate_if_too_long() const;

 private:
  void follow() const;

  const Options options_;
};

/// Renames a log that exceeds its limit: `<path>` becomes `<path>.1` and so on. `written` is an open descriptor of the
/// log; its file lock decides which of several processes renames the log, and is held until the descriptor is closed.
/// Does nothing if `<path>` is missing or another file, or may not be renamed. \return whether it was renamed.
bool move_log(const LogFile::Options& options, int written);

}  // namespace iotcloud::processes
