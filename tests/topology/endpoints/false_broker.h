#pragma once

#include <array>
#include <mutex>
#include <string>
#include <thread>

#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <iotcloud/tests/loopback_listener.h>

namespace iotcloud::topology {

/// Greets clients as RabbitMQ does (AMQP 0-9-1, Connection.Start with the mechanism PLAIN), and records what they
/// answer: a thief's server, to which a record in the registry leads. One client at a time.
class FalseBroker {
 public:
  FalseBroker() {
    thread_ = std::jthread([this](const std::stop_token& stop) { serve(stop); });
  }
  FalseBroker(const FalseBroker&) = delete;
  FalseBroker& operator=(const FalseBroker&) = delete;

  std::string url() const { return "amqp://127.0.0.1:" + std::to_string(listener_.port()); }
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
      if (!readable(listener_.socket())) continue;
      const int client = listener_.accept();
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

  const tests::LoopbackListener listener_;
  mutable std::mutex mutex_;
  std::string heard_;    ///< guarded by mutex_
  std::jthread thread_;  ///< last: it uses the others
};

}  // namespace iotcloud::topology
