#pragma once

#include <array>
#include <cstdint>
#include <mutex>
#include <string>
#include <thread>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "iotcloud/tests/fuzz/bytes.h"

namespace iotcloud::fuzz {

/// A server on loopback that answers each connection with the same bytes, whatever the client says, and closes it.
class AnsweringServer {
 public:
  AnsweringServer() : listener_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    must(bind(listener_, reinterpret_cast<const sockaddr*>(&address), size) == 0 && listen(listener_, 8) == 0 &&
             getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size) == 0,
         "a server on loopback");
    port_ = ntohs(address.sin_port);
    std::thread([this] { serve(); }).detach();
  }
  int port() const { return port_; }
  void answer_with(std::string bytes) {
    const std::lock_guard lock(mutex_);
    answer_ = std::move(bytes);
  }

 private:
  [[noreturn]] void serve() {
    std::array<char, 65536> heard{};
    while (true) {
      const int client = accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
      if (client < 0) continue;
      // The client speaks first. What it says must be read, or closing the socket would cut the answer off.
      static_cast<void>(recv(client, heard.data(), heard.size(), 0));
      const std::string answer = [this] {
        const std::lock_guard lock(mutex_);
        return answer_;
      }();
      static_cast<void>(send(client, answer.data(), answer.size(), MSG_NOSIGNAL));
      shutdown(client, SHUT_WR);
      while (recv(client, heard.data(), heard.size(), 0) > 0) continue;
      close(client);
    }
  }

  const int listener_;
  int port_ = 0;
  std::mutex mutex_;
  std::string answer_;
};

/// The one of this process, which is never destroyed: its thread serves until the process ends.
inline AnsweringServer& answering_server() {
  static auto* const server = new AnsweringServer;
  return *server;
}

}  // namespace iotcloud::fuzz
