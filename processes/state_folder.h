#pragma once

#include <string>

#include <iotcloud/processes/descriptor.h>

namespace iotcloud::processes {

/// The folder in which a daemon keeps what outlives it: the sockets and logs of the processes that it started, and an
/// id by which its next run is recognized. Only one daemon at a time can use it.
class StateFolder {
 public:
  /// Makes the folder when it is missing, and locks it. Only its owner may use it and the files in it: rights of others
  /// are taken away, with a line in the log.
  /// \throws config::Error if it cannot be made or locked, or another process uses it.
  explicit StateFolder(const std::string& path);

  const std::string& path() const { return path_; }
  const std::string& id() const { return id_; }  ///< random, the same in every run

 private:
  const std::string path_;
  OwnedDescriptor lock_;
  std::string id_;
};

}  // namespace iotcloud::processes
