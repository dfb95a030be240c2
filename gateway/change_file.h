#pragma once

#include <cstddef>
#include <deque>
#include <string>

#include <iotcloud/gateway/change_log.h>
#include <iotcloud/gateway/host/control/unix_socket.h>

namespace iotcloud::gateway {

/// Where a gateway's changes of state outlive it: a file with a JSON object on each line, to which each change is added
/// as it comes; when it has twice as many as are kept it is replaced by a shorter one, at once and whole. A process
/// that is killed loses nothing, a machine that loses its power perhaps the last seconds. When the disk is full or
/// read-only that is logged, once, and tried again with the next change. Not thread safe; one process at a time.
class ChangeFile {
 public:
  /// \param most how many changes are kept.
  ChangeFile(std::string path, std::size_t most) : path_(std::move(path)), most_(most) {}

  /// What an earlier life left, the oldest first; nothing when there is none. A last line that is not whole is left
  /// out. A file that is damaged elsewhere is set aside as <path>.damaged with a warning; what stands before the damage
  /// is told. Never throws.
  std::deque<StateChange> load();
  /// \param all the changes kept, of which the latest was not added yet.
  void add(const std::deque<StateChange>& all);

 private:
  void append(const StateChange& change);
  void replace(const std::deque<StateChange>& all);
  void trouble(const std::string& problem);

  const std::string path_;
  const std::size_t most_;
  OwnedDescriptor file_;   ///< none: it is to be written anew
  std::size_t lines_ = 0;  ///< in it
  bool told_ = false;      ///< of trouble that lasts
};

}  // namespace iotcloud::gateway
