#pragma once

#include <array>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

#include <sys/socket.h>
#include <unistd.h>

#include "iotcloud/tests/loopback_listener.h"

namespace iotcloud::fuzz {

/// A server on loopback that answers each connection with the same bytes, whatever the client says, and closes it.
class AnsweringServer {
 public:
  AnsweringServer() {
    std::thread([this] { serve(); }).detach();
  }
  int port() const { return listener_.port(); }
  void answer_with(std::string bytes) {
    const std::lock_guard lock(mutex_);
    answer_ = std::move(bytes);
  }

 private:
  [[noreturn]] void serve() {
    std::array<char, 65536> heard{};
    while (true) {
      const int client = listener_.accept();
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

  const tests::LoopbackListener listener_;
  std::mutex mutex_;
  std::string answer_;
};

/// The one of this process, which is never destroyed: its thread serves until the process ends.
inline AnsweringServer& answering_server() {
  static auto* const server = new AnsweringServer;
  return *server;
}

}  // namespace iotcloud::fuzz
