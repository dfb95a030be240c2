#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <stdexcept>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/turtle/robot/address.h>

namespace iotcloud::drivers::turtle::robot {

namespace {

constexpr std::size_t shortest_token = 16;

struct Parsed {
  sockaddr_storage storage{};
  socklen_t size = 0;
  const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&storage); }
};

[[noreturn]] void refuse(const std::string& address) {
  throw std::invalid_argument("\"" + address +
                              "\" is no address to listen at; write 127.0.0.1:7411, [::1]:7411 or 0.0.0.0:7411");
}

Parsed parse(const std::string& address) {
  auto [host, port_text] = split_address(address);
  if (host == "localhost") host = "127.0.0.1";
  std::uint16_t port = 0;
  const char* stop = port_text.data() + port_text.size();
  const auto [end, status] = std::from_chars(port_text.data(), stop, port);
  if (status != std::errc{} || end != stop) refuse(address);
  Parsed parsed;
  auto* four = reinterpret_cast<sockaddr_in*>(&parsed.storage);
  auto* six = reinterpret_cast<sockaddr_in6*>(&parsed.storage);
  if (inet_pton(AF_INET, host.c_str(), &four->sin_addr) == 1) {
    four->sin_family = AF_INET;
    four->sin_port = htons(port);
    parsed.size = sizeof *four;
  } else if (inet_pton(AF_INET6, host.c_str(), &six->sin6_addr) == 1) {
    six->sin6_family = AF_INET6;
    six->sin6_port = htons(port);
    parsed.size = sizeof *six;
  } else {
    refuse(address);
  }
  return parsed;
}

}  // namespace

std::pair<std::string, std::string> split_address(const std::string& address) {
  const auto colon = address.rfind(':');
  if (colon == std::string::npos || colon == 0 || colon + 1 == address.size()) {
    throw std::invalid_argument("\"" + address + "\" is no address; write HOST:PORT");
  }
  std::string host = address.substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  return {host, address.substr(colon + 1)};
}

bool is_loopback(const std::string& address) {
  const std::string host = split_address(address).first;
  in_addr four{};
  in6_addr six{};
  if (inet_pton(AF_INET, host.c_str(), &four) == 1) return ntohl(four.s_addr) >> 24 == 127;
  return host == "localhost" || (inet_pton(AF_INET6, host.c_str(), &six) == 1 && IN6_IS_ADDR_LOOPBACK(&six));
}

int listen_at(const std::string& address) {
  const Parsed parsed = parse(address);
  const int listener = socket(parsed.storage.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  const int on = 1;
  if (listener >= 0) setsockopt(listener, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (listener < 0 || bind(listener, parsed.get(), parsed.size) != 0 || listen(listener, 8) != 0) {
    const int problem = errno;
    if (listener >= 0) close(listener);
    throw std::runtime_error("cannot listen at " + address + ": " + std::strerror(problem) +
                             (problem == EADDRINUSE ? "; each robot needs a port of its own" : ""));
  }
  return listener;
}

std::string address_of(int socket) {
  Parsed parsed;
  parsed.size = sizeof parsed.storage;
  if (getsockname(socket, reinterpret_cast<sockaddr*>(&parsed.storage), &parsed.size) != 0) return "";
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (parsed.storage.ss_family == AF_INET6) {
    const auto* six = reinterpret_cast<const sockaddr_in6*>(&parsed.storage);
    inet_ntop(AF_INET6, &six->sin6_addr, text.data(), text.size());
    return "[" + std::string(text.data()) + "]:" + std::to_string(ntohs(six->sin6_port));
  }
  const auto* four = reinterpret_cast<const sockaddr_in*>(&parsed.storage);
  inet_ntop(AF_INET, &four->sin_addr, text.data(), text.size());
  return std::string(text.data()) + ":" + std::to_string(ntohs(four->sin_port));
}

void check_token(const std::string& address, const std::string& token, const std::string& property) {
  if (token.empty() && is_loopback(address)) return;
  if (token.size() >= shortest_token) return;
  throw std::invalid_argument(
      property + " is " + (token.empty() ? "missing" : "too short") + ": " + address +
      (token.empty() ? " can be reached from other machines, so both ends need the same secret" : " needs a secret") +
      " of at least " + std::to_string(shortest_token) + " characters (openssl rand -hex 32)");
}

}  // namespace iotcloud::drivers::turtle::robot
