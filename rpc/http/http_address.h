#pragma once

#include <string>

namespace iotcloud::rpc {

/// "host:port" in its two parts.
struct HttpAddress {
  /// Brackets of an IPv6 address go. Nothing is checked: without a colon the port is empty.
  explicit HttpAddress(const std::string& address) {
    const auto colon = address.rfind(':');
    host = address.substr(0, colon);
    if (colon != std::string::npos) port = address.substr(colon + 1);
    if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  }
  std::string host;
  std::string port;
};

}  // namespace iotcloud::rpc
