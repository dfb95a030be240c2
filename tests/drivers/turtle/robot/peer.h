#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <deque>
#include <optional>
#include <string>
#include <thread>

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/drivers/turtle/robot/protocol.h>

namespace iotcloud::drivers::turtle::robot {

/// Calls `work` until the condition is true, for a minute at most.
template <typename Condition, typename Work>
bool run_until(Condition holds, Work work) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (!holds()) {
    if (std::chrono::steady_clock::now() > deadline) return false;
    work();
    std::this_thread::yield();
  }
  return true;
}

/// The test's end of a connection: a socket that never blocks.
class Peer {
 public:
  explicit Peer(int socket) : socket_(socket) { fcntl(socket_, F_SETFL, fcntl(socket_, F_GETFL) | O_NONBLOCK); }
  Peer(Peer&& other) noexcept : socket_(std::exchange(other.socket_, -1)) {}
  ~Peer() { hang_up(); }
  static Peer connect_to(std::uint16_t port) {
    const int socket = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    connect(socket, reinterpret_cast<sockaddr*>(&address), sizeof address);
    return Peer(socket);
  }

  void send(const std::string& bytes) {
    std::size_t sent = 0;
    while (sent < bytes.size()) {
      const ssize_t count = ::send(socket_, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
      if (count > 0) sent += static_cast<std::size_t>(count);
      if (count < 0 && errno != EAGAIN) return;
    }
  }
  /// Reads what has arrived.
  void pump() {
    std::array<std::byte, 65536> buffer;
    for (;;) {
      const ssize_t count = recv(socket_, buffer.data(), buffer.size(), 0);
      if (count < 0 && errno == EAGAIN) return;
      if (count <= 0) {
        ended_ = true;
        return;
      }
      auto bytes = std::span<const std::byte>(buffer.data(), static_cast<std::size_t>(count));
      while (const auto message = reader_.take(bytes)) {
        if (message->kind != Kind::alive) messages_.push_back(*message);
        if (message->kind == Kind::alive) ++beats_;
      }
    }
  }
  /// Takes the oldest message that was not taken yet.
  std::optional<Incoming> take() {
    pump();
    if (messages_.empty()) return std::nullopt;
    const Incoming message = messages_.front();
    messages_.pop_front();
    return message;
  }
  std::size_t waiting() {
    pump();
    return messages_.size();
  }
  bool ended() {
    pump();
    return ended_;
  }
  int beats() const { return beats_; }
  void hang_up() {
    if (socket_ >= 0) close(socket_);
    socket_ = -1;
  }

 private:
  int socket_;
  MessageReader reader_{most_to_driver};
  std::deque<Incoming> messages_;
  bool ended_ = false;
  int beats_ = 0;
};

}  // namespace iotcloud::drivers::turtle::robot
