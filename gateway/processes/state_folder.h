#pragma once

#include <string>

#include <iotcloud/gateway/host/control/unix_socket.h>

namespace iotcloud::gateway {

/// The folder in which a gateway keeps what outlives it: the sockets and logs of its driver hosts, the history of its
/// instances, and a name by which its next life is known. One gateway at a time.
class StateFolder {
 public:
  /// Makes the folder when it is missing (for its owner only) and locks it.
  /// \throws config::Error when it cannot, or when another gateway uses it.
  explicit StateFolder(const std::string& path);

  const std::string& path() const { return path_; }
  const std::string& id() const { return id_; }  ///< random, the same in every life

 private:
  const std::string path_;
  OwnedDescriptor lock_;
  std::string id_;
};

}  // namespace iotcloud::gateway
