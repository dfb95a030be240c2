#pragma once

#include <cstddef>
#include <deque>
#include <string>

#include <iotcloud/gateway/change_log.h>
#include <iotcloud/processes/descriptor.h>

namespace iotcloud::gateway {

/// Keeps a gateway's changes of state across restarts, in a file with a JSON object on each line. Each change is
/// appended when it happens. When the file has twice as many lines as are kept, a shorter file replaces it atomically.
/// If the process is killed nothing is lost; if the machine loses power, only what was appended after the last sync()
/// is. A write that fails (disk full or read-only) is logged once, and the next change tries again. Not thread safe;
/// one process at a time.
class ChangeFile {
 public:
  /// \param most how many changes are kept.
  ChangeFile(std::string path, std::size_t most) : path_(std::move(path)), most_(most) {}

  /// Reads the changes that an earlier run of the gateway wrote, the oldest first; empty if there is no file. Ignores
  /// an incomplete last line. Renames a file that is damaged elsewhere to <path>.damaged, logs a warning and returns
  /// the changes before the damage. Never throws.
  std::deque<StateChange> load();
  /// Whether the next change must be written with replace(), because the file is not open (at the start, and after a
  /// failed write) or has become too long.
  bool wants_all() const { return !file_ || lines_ >= 2 * most_; }
  void append(const StateChange& change);
  /// Waits until what was appended is on the disk; does nothing if it is.
  void sync();
  /// Waits until they are on the disk. \param all all changes to keep, including the new one.
  void replace(const std::deque<StateChange>& all);

 private:
  void trouble(const std::string& problem);

  const std::string path_;
  const std::size_t most_;
  processes::OwnedDescriptor file_;  ///< empty: the next write must be replace()
  std::size_t lines_ = 0;            ///< number of lines in the file
  bool synced_ = true;               ///< nothing was appended since the last sync() or replace()
  bool told_ = false;                ///< a failed write was logged and none has succeeded since
};

}  // namespace iotcloud::gateway
