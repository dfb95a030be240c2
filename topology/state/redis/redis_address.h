#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

namespace iotcloud::topology::internal {

/// One server of a Redis.
struct RedisServer {
  std::string host;  ///< IPv6 without its brackets
  std::uint16_t port = 6379;
};

/// The parts of a store's URL: redis://[USER@]HOST[:PORT][,HOST[:PORT]...][?OPTION=VALUE[&...]], with TLS "rediss".
struct RedisAddress {
  std::string text;  ///< the URL; it has no password
  bool tls = false;
  std::string user;
  std::vector<RedisServer> servers;  ///< one of them is the master, the others follow it
  std::string password_file;         ///< a file whose first line is the password
  std::string password_variable;     ///< the environment variable with the password
  std::string ca_file;               ///< whom to trust; empty: the system's authorities
  std::string certificate_file;      ///< the client's own; empty: none
  std::string key_file;
  std::string revoked_file;  ///< servers that are not to be trusted: lists of revocations; empty: none
  std::string prefix;        ///< keeps this system's keys apart from those of another one; empty: none
  std::chrono::milliseconds answer_limit{2000};  ///< for connecting, and for each answer
};

/// Reads a URL, and refuses one whose servers others on the network could impersonate or listen to: beyond loopback it
/// takes TLS and a user with a password. \throws StateError
RedisAddress parse_redis_address(const std::string& url);

/// The password that the address names, read anew at each call; empty if it names none. \throws StateError
std::string password_of(const RedisAddress& address);

}  // namespace iotcloud::topology::internal
