#pragma once

#include <string>

namespace iotcloud::config {

/// Whether only this machine can reach the host: "localhost", an address of 127.0.0.0/8, or "::1".
bool is_loopback(const std::string& host);

/// Whether the host is an IPv4 or IPv6 address, not a name.
bool is_address(const std::string& host);

/// The name of this machine; "host" if it has none.
std::string host_name();

/// The rule for every port that a daemon opens: what other machines can reach needs TLS and tokens. \param danger what
/// strangers could do there: "give orders". \return why the port must not be opened; empty if it may.
std::string exposure(const std::string& host, bool has_tls, bool has_tokens, const std::string& danger);

}  // namespace iotcloud::config
