#include "iotcloud/tests/brokers/tampering_proxy.h"

#include <stdexcept>
#include <string_view>
#include <utility>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

namespace iotcloud::tests {
namespace {

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(port);
  return address;
}

bool send_all(int socket, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t count = ::send(socket, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (count <= 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(count));
  }
  return true;
}

}  // namespace

TamperingProxy::TamperingProxy(std::uint16_t server_port, std::uint16_t port) : server_port_(server_port) {
  listener_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  wake_ = ::eventfd(0, EFD_CLOEXEC);
  const int on = 1;  // the port may have served another proxy a moment ago
  ::setsockopt(listener_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  sockaddr_in address = loopback(port);
  socklen_t length = sizeof(address);
  if (::bind(listener_, reinterpret_cast<sockaddr*>(&address), length) != 0 || ::listen(listener_, 16) != 0 ||
      ::getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &length) != 0) {
    throw std::runtime_error("the proxy cannot listen");
  }
  port_ = ntohs(address.sin_port);
  thread_ = std::thread([this] { run(); });
}

TamperingProxy::~TamperingProxy() {
  ending_ = true;
  const std::uint64_t one = 1;
  [[maybe_unused]] const auto written = ::write(wake_, &one, sizeof(one));
  thread_.join();
  for (const Pair& pair : pairs_) {
    ::close(pair.client);
    ::close(pair.server);
  }
  ::close(listener_);
  ::close(wake_);
}

void TamperingProxy::replace(std::string words, std::string others) {
  const std::lock_guard lock(mutex_);
  words_ = std::move(words);
  others_ = std::move(others);
}

void TamperingProxy::inject(std::string bytes) {
  {
    const std::lock_guard lock(mutex_);
    injection_ = std::move(bytes);
  }
  const std::uint64_t one = 1;
  [[maybe_unused]] const auto written = ::write(wake_, &one, sizeof(one));
}

std::string TamperingProxy::heard() const {
  const std::lock_guard lock(mutex_);
  return heard_;
}

void TamperingProxy::accept_one() {
  const int client = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
  if (client < 0) return;
  const int server = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const sockaddr_in address = loopback(server_port_);
  if (::connect(server, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
    ::close(client);
    ::close(server);
    return;
  }
  pairs_.push_back({client, server});
  ++connections_;
}

bool TamperingProxy::forward(const Pair& pair, bool from_server) {
  char buffer[65536];
  const ssize_t count = ::recv(from_server ? pair.server : pair.client, buffer, sizeof(buffer), 0);
  if (count <= 0) return false;
  std::string bytes(buffer, static_cast<std::size_t>(count));
  {
    const std::lock_guard lock(mutex_);
    if (from_server) {
      for (std::size_t at = 0; !words_.empty() && (at = bytes.find(words_, at)) != std::string::npos;) {
        bytes.replace(at, words_.size(), others_);
        at += others_.size();
      }
    } else {
      heard_ += bytes;
    }
  }
  return send_all(from_server ? pair.client : pair.server, bytes);
}

void TamperingProxy::run() {
  while (!ending_) {
    std::vector<pollfd> sockets{{wake_, POLLIN, 0}, {listener_, POLLIN, 0}};
    for (const Pair& pair : pairs_) {
      sockets.push_back({pair.client, POLLIN, 0});
      sockets.push_back({pair.server, POLLIN, 0});
    }
    ::poll(sockets.data(), sockets.size(), -1);
    std::vector<Pair> left;
    for (std::size_t i = 0; i < pairs_.size(); ++i) {
      const bool stays = (sockets[2 + 2 * i].revents == 0 || forward(pairs_[i], false)) &&
                         (sockets[3 + 2 * i].revents == 0 || forward(pairs_[i], true));
      if (stays) {
        left.push_back(pairs_[i]);
      } else {
        ::close(pairs_[i].client);
        ::close(pairs_[i].server);
      }
    }
    pairs_ = std::move(left);
    if (sockets[0].revents != 0) {
      std::uint64_t count = 0;
      [[maybe_unused]] const auto got = ::read(wake_, &count, sizeof(count));
      const std::lock_guard lock(mutex_);
      for (const Pair& pair : pairs_) send_all(pair.client, injection_);
    }
    if (sockets[1].revents != 0) accept_one();
  }
}

}  // namespace iotcloud::tests
