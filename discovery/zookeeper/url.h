#pragma once

#include <string>

namespace iotcloud::discovery::zookeeper {

/// What "zookeeper://host:port,host:port/chroot" says.
struct Url {
  std::string hosts;   ///< "host:port,host:port", as the C client takes it
  std::string chroot;  ///< "/a/b", or empty
};

/// A port that is not given is 2181. \throws config::Error.
Url parse_url(const std::string& url);

}  // namespace iotcloud::discovery::zookeeper
