#pragma once

#include <string>
#include <utility>

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

namespace iotcloud::tests {

/// One connection to a port of this machine, over which a test says and hears any bytes.
class RawClient {
 public:
  explicit RawClient(int port) : fd_(socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(port));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(connect(fd_, reinterpret_cast<const sockaddr*>(&to), sizeof to), 0);
  }
  /// \param address "127.0.0.1:40112"
  explicit RawClient(const std::string& address) : RawClient(std::stoi(address.substr(address.rfind(':') + 1))) {}
  ~RawClient() { close(fd_); }
  RawClient(const RawClient&) = delete;
  RawClient& operator=(const RawClient&) = delete;

  int descriptor() const { return fd_; }
  void say(const std::string& bytes) const {
    EXPECT_EQ(send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL), static_cast<ssize_t>(bytes.size()));
  }
  /// All that comes until the server closes the connection.
  std::string rest() {
    while (more()) {
    }
    return std::exchange(heard_, "");
  }
  /// What comes, until it contains the text; without the text if the server closes before.
  std::string until(const std::string& text) {
    while (heard_.find(text) == std::string::npos && more()) {
    }
    const auto end = heard_.find(text);
    if (end == std::string::npos) return std::exchange(heard_, "");
    auto part = heard_.substr(0, end + text.size());
    heard_.erase(0, part.size());
    return part;
  }

 private:
  bool more() {
    char buffer[4096];
    const ssize_t count = recv(fd_, buffer, sizeof buffer, 0);
    if (count > 0) heard_.append(buffer, static_cast<std::size_t>(count));
    return count > 0;
  }

  const int fd_;
  std::string heard_;
};

}  // namespace iotcloud::tests
