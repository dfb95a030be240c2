#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <random>
#include <stdexcept>
#include <string>

#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

namespace iotcloud::tests {

/// Whether no other process of the tests has chosen this port; then it is this one's until the process ends.
inline bool reserve(int port) {
  // As in private_server.py: an abstract socket, which goes with this process.
  const int mark = ::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  const std::string name = "iotcloud-port-" + std::to_string(port);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::copy(name.begin(), name.end(), address.sun_path + 1);
  const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + 1 + name.size());
  if (mark >= 0 && ::bind(mark, reinterpret_cast<const sockaddr*>(&address), size) == 0) return true;
  if (mark >= 0) ::close(mark);
  return false;
}

/// A port of the loopback interface that is free now and reserved for this process, as those of private_server.py:
/// below the range from which the kernel takes ports, so that nobody else gets it while nobody listens there. Not
/// thread safe. \throws std::runtime_error if none is found.
inline int free_port() {
  int first_ephemeral = 0;
  std::ifstream("/proc/sys/net/ipv4/ip_local_port_range") >> first_ephemeral;
  static std::mt19937 random{std::random_device()()};
  std::uniform_int_distribution<int> choose(10'000, std::max(10'500, first_ephemeral) - 1);
  for (int tries = 0; tries < 10'000; ++tries) {
    const int port = choose(random);
    const int probe = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const int on = 1;
    ::setsockopt(probe, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    const bool free = ::bind(probe, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
    ::close(probe);
    if (free && reserve(port)) return port;
  }
  throw std::runtime_error("no free port on the loopback interface");
}

}  // namespace iotcloud::tests
