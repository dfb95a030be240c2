#pragma once

#include <array>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>

#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

namespace iotcloud::topology {

/// Greets clients as RabbitMQ does (AMQP 0-9-1, Connection.Start with the mechanism PLAIN), and records what they
/// answer: a thief's server, to which a record in the registry leads. One client at a time.
class FalseBroker {
 public:
  FalseBroker() : listener_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    if (bind(listener_, reinterpret_cast<sockaddr*>(&address), size) != 0 || listen(listener_, 8) != 0 ||
        getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
      throw std::runtime_error("no port to listen on");
    }
    port_ = ntohs(address.sin_port);
    thread_ = std::jthread([this](const std::stop_token& stop) { serve(stop); });
  }
  ~FalseBroker() {
    thread_ = {};
    close(listener_);
  }
  FalseBroker(const FalseBroker&) = delete;
  FalseBroker& operator=(const FalseBroker&) = delete;

  std::string url() const { return "amqp://127.0.0.1:" + std::to_string(port_); }
  /// Everything that clients have sent.
  std::string heard() const {
    const std::lock_guard lock(mutex_);
    return heard_;
  }

 private:
  static constexpr int look_ms = 20;  ///< how often it looks whether it is to end

  static bool readable(int descriptor) {
    pollfd waiting{descriptor, POLLIN, 0};
    return poll(&waiting, 1, look_ms) > 0;
  }

  void serve(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      if (!readable(listener_)) continue;
      const int client = accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
      if (client < 0) continue;
      static const std::string start =
          std::string("\x01\0\0\0\0\0\x1c\0\x0a\0\x0a\0\x09\0\0\0\0", 17) + std::string(
                                                                                "\0\0\0\x05PLAIN\0\0\0\x05"
                                                                                "en_US\xce",
                                                                                19);
      send(client, start.data(), start.size(), MSG_NOSIGNAL);
      std::array<char, 4096> bytes{};
      while (!stop.stop_requested()) {
        if (!readable(client)) continue;
        const auto got = recv(client, bytes.data(), bytes.size(), 0);
        if (got <= 0) break;
        const std::lock_guard lock(mutex_);
        heard_.append(bytes.data(), static_cast<std::size_t>(got));
      }
      close(client);
    }
  }

  const int listener_;
  int port_ = 0;
  mutable std::mutex mutex_;
  std::string heard_;  ///< guarded by mutex_
  std::jthread thread_;
};

}  // namespace iotcloud::topology
