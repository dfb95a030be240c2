#include <array>

#include <arpa/inet.h>
#include <fmt/format.h>
#include <unistd.h>

#include <iotcloud/config/exposure.h>

namespace iotcloud::config {

bool is_loopback(const std::string& host) {
  if (host == "localhost" || host == "::1") return true;
  in_addr address{};
  return inet_pton(AF_INET, host.c_str(), &address) == 1 && (ntohl(address.s_addr) >> 24) == 127;
}

bool is_address(const std::string& host) {
  std::array<unsigned char, sizeof(in6_addr)> bytes{};
  return inet_pton(AF_INET, host.c_str(), bytes.data()) == 1 || inet_pton(AF_INET6, host.c_str(), bytes.data()) == 1;
}

std::string host_name() {
  std::array<char, 256> name{"host"};
  static_cast<void>(gethostname(name.data(), name.size() - 1));
  return name.data();
}

std::string exposure(const std::string& host, bool has_tls, bool has_tokens, const std::string& danger) {
  if (is_loopback(host) || (has_tls && has_tokens)) return "";
  const char* missing = has_tls ? "tokens" : has_tokens ? "TLS" : "TLS and tokens";
  return fmt::format("{} can be reached from other machines, and without {} anybody there could {}", host, missing,
                     danger);
}

}  // namespace iotcloud::config
