#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace iotcloud::tests {

/// Stands between clients and a server on loopback, and changes what the server says. Thread safe.
class TamperingProxy {
 public:
  explicit TamperingProxy(std::uint16_t server_port);
  ~TamperingProxy();
  TamperingProxy(const TamperingProxy&) = delete;
  TamperingProxy& operator=(const TamperingProxy&) = delete;

  std::uint16_t port() const { return port_; }
  /// From now on the server's `words` arrive as `others` (of the same length).
  void replace(std::string words, std::string others);
  /// Each client gets these bytes in the middle of what the server says.
  void inject(std::string bytes);
  /// So many connections there have been.
  int connections() const { return connections_; }

 private:
  struct Pair {
    int client;
    int server;
  };
  void run();
  void accept_one();
  /// \return false when one side is gone
  bool forward(const Pair& pair, bool from_server);

  const std::uint16_t server_port_;
  std::uint16_t port_ = 0;
  int listener_ = -1;
  int wake_ = -1;
  std::atomic<bool> ending_ = false;
  std::atomic<int> connections_ = 0;
  std::vector<Pair> pairs_;  ///< the thread's
  std::mutex mutex_;
  std::string words_, others_;  ///< guarded by mutex_
  std::string injection_;       ///< guarded by mutex_
  std::thread thread_;
};

}  // namespace iotcloud::tests
