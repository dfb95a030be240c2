#pragma once

#include <chrono>
#include <memory>

#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/zookeeper/url.h>

namespace iotcloud::discovery::zookeeper {

/// Sessions with a ZooKeeper ensemble through its C client. The chroot is made when it is missing.
std::unique_ptr<Connection> make_connection(const Url& url, std::chrono::milliseconds session_timeout);

}  // namespace iotcloud::discovery::zookeeper
