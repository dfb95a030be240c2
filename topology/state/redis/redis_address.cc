#include <cstdlib>
#include <fstream>
#include <optional>
#include <string_view>
#include <utility>

#include <arpa/inet.h>

#include <iotcloud/config/number.h>
#include <iotcloud/topology/state/redis/redis_address.h>
#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::internal {

namespace {

constexpr std::string_view redis_scheme = "redis://", redis_tls_scheme = "rediss://";

StateError unusable(const std::string& url, const std::string& problem) {
  return StateError("the state store \"" + url + "\" cannot be used: " + problem);
}

bool stays_on_this_machine(const std::string& host) {
  if (host == "localhost" || host == "::1") return true;
  in_addr address{};
  return inet_pton(AF_INET, host.c_str(), &address) == 1 && (ntohl(address.s_addr) >> 24) == 127;
}

/// Cuts `text` at the first `mark`: \return what is before it; `text` keeps the rest.
std::string_view cut(std::string_view& text, char mark) {
  const auto end = text.find(mark);
  const std::string_view first = text.substr(0, end);
  text = end == std::string_view::npos ? std::string_view() : text.substr(end + 1);
  return first;
}

RedisServer server_of(const std::string& url, std::string_view text) {
  const auto colon = text.rfind(':');
  const bool has_port = colon != std::string_view::npos && text.find(']', colon) == std::string_view::npos;
  RedisServer server;
  std::string_view host = has_port ? text.substr(0, colon) : text;
  if (host.starts_with('[') && host.ends_with(']')) host = host.substr(1, host.size() - 2);
  server.host = host;
  if (has_port) {
    const std::string_view digits = text.substr(colon + 1);
    server.port = config::parse_number<decltype(server.port)>(digits).value_or(0);
  }
  if (server.host.empty() || server.port == 0) {
    throw unusable(url, "\"" + std::string(text) + "\" is no HOST:PORT; write redis://127.0.0.1:6379");
  }
  return server;
}

std::chrono::milliseconds limit_of(const RedisAddress& address, std::string_view text) {
  constexpr int least = 10, most = 600'000;
  const auto limit = config::parse_number<int>(text);
  if (!limit || *limit < least || *limit > most)
    throw unusable(address.text, "answer_limit_ms takes a number from 10 to 600000, not \"" + std::string(text) + "\"");
  return std::chrono::milliseconds(*limit);
}

void read_option(RedisAddress& address, std::string_view name, std::string_view value) {
  if (name == "answer_limit_ms") {
    address.answer_limit = limit_of(address, value);
    return;
  }
  const std::pair<std::string_view, std::string*> options[] = {{"password_file", &address.password_file},
                                                               {"password_variable", &address.password_variable},
                                                               {"ca_file", &address.ca_file},
                                                               {"certificate_file", &address.certificate_file},
                                                               {"key_file", &address.key_file},
                                                               {"revoked_file", &address.revoked_file},
                                                               {"prefix", &address.prefix}};
  for (const auto& [known, place] : options) {
    if (name != known) continue;
    *place = value;
    return;
  }
  throw unusable(address.text, "it has no option \"" + std::string(name) +
                                   "\"; there are password_file, password_variable, ca_file, certificate_file, "
                                   "key_file, revoked_file, prefix and answer_limit_ms");
}

/// Refuses a prefix that could be mistaken for the beginning of another one's keys.
void check_prefix(const RedisAddress& address) {
  constexpr std::string_view allowed = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.-_";
  if (address.prefix.find_first_not_of(allowed) == std::string::npos) return;
  throw unusable(address.text,
                 "the prefix \"" + address.prefix + "\" has more than letters, digits, \".\", \"-\" and \"_\"");
}

/// Refuses what the network between this machine and a server could read or forge.
void check_exposure(const RedisAddress& address) {
  for (const RedisServer& server : address.servers) {
    if (stays_on_this_machine(server.host)) continue;
    const std::string who = server.host + " is another machine, ";
    if (!address.tls) {
      throw unusable(address.text, who +
                                       "and without TLS anybody between could read and change the state; write "
                                       "rediss://USER@HOST:PORT?password_file=..., or give the address of a tunnel "
                                       "on 127.0.0.1");
    }
    if (address.user.empty() || (address.password_file.empty() && address.password_variable.empty())) {
      throw unusable(address.text,
                     who +
                         "which must know who writes; make an ACL user (topology/state/README.md says which rights "
                         "it needs) and write rediss://USER@HOST:PORT?password_file=...");
    }
  }
}

}  // namespace

RedisAddress parse_redis_address(const std::string& url) {
  RedisAddress address;
  address.text = url;
  address.tls = url.starts_with(redis_tls_scheme);
  std::string_view options = std::string_view(url).substr((address.tls ? redis_tls_scheme : redis_scheme).size());
  std::string_view servers = cut(options, '?');
  if (const auto at = servers.find('@'); at != std::string_view::npos) {
    address.user = servers.substr(0, at);
    servers.remove_prefix(at + 1);
    if (address.user.find(':') != std::string::npos) {
      address.text = "redis://...@" + std::string(servers);
      throw unusable(address.text,
                     "a URL is seen by many, so the password must not be in it; name a file: ?password_file=...");
    }
  }
  if (servers.ends_with('/')) servers.remove_suffix(1);
  do address.servers.push_back(server_of(url, cut(servers, ',')));
  while (!servers.empty());
  while (!options.empty()) {
    std::string_view option = cut(options, '&');
    const std::string_view name = cut(option, '=');
    read_option(address, name, option);
  }
  if (!address.password_file.empty() && !address.password_variable.empty()) {
    throw unusable(url, "it names the password twice; keep password_file or password_variable");
  }
  if (!address.tls && !address.revoked_file.empty()) {
    throw unusable(url, "without TLS no server shows a certificate, so revoked_file says nothing; write rediss://");
  }
  check_prefix(address);
  check_exposure(address);
  return address;
}

std::string password_of(const RedisAddress& address) {
  if (!address.password_variable.empty()) {
    const char* const value = std::getenv(address.password_variable.c_str());
    if (value == nullptr) throw unusable(address.text, "the variable " + address.password_variable + " is not set");
    return value;
  }
  if (address.password_file.empty()) return {};
  std::ifstream file(address.password_file);
  std::string password;
  if (!std::getline(file, password) || password.empty()) {
    throw unusable(address.text, "the file " + address.password_file + " cannot be read, or its first line is empty");
  }
  return password;
}

}  // namespace iotcloud::topology::internal
