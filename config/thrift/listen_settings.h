#pragma once

#include <string>

#include <iotcloud/config/thrift/tls.h>
#include <iotcloud/config/yaml.h>

namespace iotcloud::config {

/// Where a Thrift service listens, and whom it lets in.
struct ListenSettings {
  std::string host = "127.0.0.1";
  int port = 0;
  TlsFiles tls;
  std::string tokens;     ///< file of tokens (access/tokens.h); empty: nobody is asked for one
  std::string advertise;  ///< host:port as others reach it
};

/// Reads `host`, `port`, `tls`, `tokens` and `advertise`; what is missing stays, advertise becomes host:port.
/// \param least_port 0 allows any free one.
/// \throws ConfigError, also when exposure() says something.
void read_listen_settings(Section& section, ListenSettings& settings, int least_port = 1);

/// Why the service must not listen so: whoever reaches it can run programs, so what others than this machine can reach
/// needs TLS and tokens. Empty: it may.
std::string exposure(const ListenSettings& settings);

/// True for what only this machine reaches: 127.0.0.0/8, ::1, localhost.
bool is_loopback(const std::string& host);

/// "host:port", the host in brackets when it has colons. \throws Error when it is none.
struct HostAndPort {
  std::string host;
  int port = 0;
};
HostAndPort split_address(const std::string& address);

}  // namespace iotcloud::config
