#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/discovery/access.h>
#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/zookeeper/url.h>

namespace iotcloud::discovery::zookeeper {

struct Settings {
  Url url;
  std::chrono::milliseconds session_timeout{10000};
  /// "user:password" for digest authentication; empty: no authentication.
  std::string identity;
  std::string user;                              ///< that of `identity`
  std::shared_ptr<const RegistryAccess> access;  ///< null: nodes are for their creator only
  bool others_may_read = false;  ///< everybody may read nodes that this process creates; needs an identity
};

/// Makes sessions with a ZooKeeper ensemble through its C client. Creates the chroot if it does not exist.
std::unique_ptr<RegistryConnection> make_connection(Settings settings);

}  // namespace iotcloud::discovery::zookeeper
