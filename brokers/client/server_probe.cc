#include "iotcloud/brokers/client/server_probe.h"

#include <cerrno>
#include <memory>
#include <utility>

#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

namespace iotcloud::brokers::client {
namespace {

struct AddressFreer {
  void operator()(addrinfo* list) const { ::freeaddrinfo(list); }
};

int begin_connecting(const std::string& host, std::uint16_t port) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found) != 0) return -1;
  const std::unique_ptr<addrinfo, AddressFreer> addresses(found);
  for (const addrinfo* address = found; address != nullptr; address = address->ai_next) {
    const int socket = ::socket(address->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (socket < 0) continue;
    if (::connect(socket, address->ai_addr, address->ai_addrlen) == 0 || errno == EINPROGRESS) return socket;
    ::close(socket);
  }
  return -1;
}

}  // namespace

ServerProbe::ServerProbe(std::string host, std::uint16_t port, std::string greeting, const config::Clock& clock)
    : host_(std::move(host)), port_(port), greeting_(std::move(greeting)), clock_(clock) {}

ServerProbe::~ServerProbe() {
  finish(false);
}

bool ServerProbe::finish(bool answer) {
  if (socket_ >= 0) ::close(socket_);
  socket_ = -1;
  under_way_ = false;
  return answer;
}

void ServerProbe::start() {
  finish(false);
  under_way_ = true;
  step_ = Step::connecting;
  started_ = clock_.now();
  socket_ = begin_connecting(host_, port_);
}

std::optional<bool> ServerProbe::poll() {
  if (!under_way_) return std::nullopt;
  if (socket_ < 0 || clock_.now() - started_ > limit_) return finish(false);
  pollfd waiting{socket_, static_cast<short>(step_ == Step::connecting ? POLLOUT : POLLIN), 0};
  if (::poll(&waiting, 1, 0) <= 0) return std::nullopt;
  if (step_ == Step::connecting) {
    int problem = 0;
    socklen_t length = sizeof(problem);
    if (::getsockopt(socket_, SOL_SOCKET, SO_ERROR, &problem, &length) != 0 || problem != 0) return finish(false);
    if (greeting_.empty()) return finish(true);
    const auto size = static_cast<ssize_t>(greeting_.size());
    if (::send(socket_, greeting_.data(), greeting_.size(), MSG_NOSIGNAL) != size) return finish(false);
    step_ = Step::greeting;
    return std::nullopt;
  }
  char byte = 0;
  return finish(::recv(socket_, &byte, 1, 0) == 1);
}

}  // namespace iotcloud::brokers::client
