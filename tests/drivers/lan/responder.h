#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <thread>

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

namespace iotcloud::drivers::lan {

/// Machines that answer questions over UDP on loopback, on a thread of its own.
class Responder {
 public:
  /// \param answer to a question; empty: none
  explicit Responder(std::function<std::string(const std::string& question)> answer)
      : socket_(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in own{};
    own.sin_family = AF_INET;
    own.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof own;
    EXPECT_EQ(::bind(socket_, reinterpret_cast<sockaddr*>(&own), size), 0);
    EXPECT_EQ(::getsockname(socket_, reinterpret_cast<sockaddr*>(&own), &size), 0);
    port_ = ntohs(own.sin_port);
    thread_ = std::thread([this, answer = std::move(answer)] {
      for (;;) {
        std::array<char, 65'536> buffer;
        sockaddr_in from{};
        socklen_t from_size = sizeof from;
        const ssize_t got =
            ::recvfrom(socket_, buffer.data(), buffer.size(), 0, reinterpret_cast<sockaddr*>(&from), &from_size);
        const std::string question(buffer.data(), got < 0 ? 0 : static_cast<std::size_t>(got));
        if (got <= 0 || question == "end") return;
        const std::string text = answer(question);
        if (!text.empty())
          ::sendto(socket_, text.data(), text.size(), 0, reinterpret_cast<sockaddr*>(&from), from_size);
      }
    });
  }
  ~Responder() {
    sockaddr_in own{};
    own.sin_family = AF_INET;
    own.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    own.sin_port = htons(port_);
    ::sendto(socket_, "end", 3, 0, reinterpret_cast<sockaddr*>(&own), sizeof own);
    thread_.join();
    ::close(socket_);
  }
  Responder(const Responder&) = delete;
  Responder& operator=(const Responder&) = delete;
  std::string address() const { return "127.0.0.1:" + std::to_string(port_); }

 private:
  const int socket_;
  std::uint16_t port_ = 0;
  std::thread thread_;
};

}  // namespace iotcloud::drivers::lan
