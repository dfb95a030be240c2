#pragma once

#include <chrono>
#include <memory>
#include <string>

#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/zookeeper/url.h>

namespace iotcloud::discovery::zookeeper {

struct Settings {
  Url url;
  std::chrono::milliseconds session_timeout{10000};
  /// "user:password" for digest authentication; empty: none.
  std::string identity;
  bool others_may_read = false;  ///< of the nodes that are created; means something with an identity only
};

/// Sessions with a ZooKeeper ensemble through its C client. The chroot is made when it is missing.
std::unique_ptr<Connection> make_connection(Settings settings);

}  // namespace iotcloud::discovery::zookeeper
