#pragma once

#include <string>
#include <vector>

#include <iotcloud/config/yaml.h>
#include <iotcloud/rpc/call_limits.h>
#include <iotcloud/security/tls.h>

namespace iotcloud::rpc {

/// Where a Thrift service listens, and how it authenticates clients.
struct ListenSettings {
  std::string host = "127.0.0.1";
  int port = 0;
  security::TlsFiles tls;
  std::string tokens;     ///< file of tokens (security/tokens.h); empty: clients need no token
  std::string advertise;  ///< the host:port by which others reach it
  /// Without tokens: accounts of this machine that may act, besides root and the daemon's own; others only read.
  std::vector<std::string> users{};
  bool open = false;  ///< without tokens: everybody on this machine may act
  CallsByRole calls = usual_calls();
};

/// Reads `host`, `port`, `tls`, `tokens`, `users`, `open`, `calls_per_second` and `advertise`. Missing keys keep their
/// values; advertise becomes host:port. \param least_port 0 allows any free port. \throws ConfigError, also if
/// exposure() gives a reason.
void read_listen_settings(config::YamlSection& section, ListenSettings& settings, int least_port = 1);

/// Why the service must not listen with these settings; empty if it may. Its clients can run programs, so a port that
/// other machines can reach needs TLS and tokens.
std::string exposure(const ListenSettings& settings);

/// An address "host:port"; a host that contains colons is written in brackets.
struct HostAndPort {
  std::string host;
  int port = 0;
};
/// Splits "host:port" or "[::1]:port". \throws config::Error for any other text.
HostAndPort split_address(const std::string& address);

}  // namespace iotcloud::rpc
