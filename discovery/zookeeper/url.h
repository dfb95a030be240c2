#pragma once

#include <string>

namespace iotcloud::discovery::zookeeper {

/// The parts of "zookeeper://host:port,host:port/chroot".
struct Url {
  std::string hosts;   ///< "host:port,host:port", in the C client's form
  std::string chroot;  ///< "/a/b", or empty
};

/// Parses a URL. A missing port becomes 2181. \throws config::Error.
Url parse_url(const std::string& url);

}  // namespace iotcloud::discovery::zookeeper
