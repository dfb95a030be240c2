#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace iotcloud::tests {

/// A proxy between clients and a server on loopback, which keeps what clients say, and changes the server's bytes.
/// Thread safe.
class TamperingProxy {
 public:
  /// \param port at which clients come; 0: one that is free
  explicit TamperingProxy(std::uint16_t server_port, std::uint16_t port = 0);
  ~TamperingProxy();
  TamperingProxy(const TamperingProxy&) = delete;
  TamperingProxy& operator=(const TamperingProxy&) = delete;

  std::uint16_t port() const { return port_; }
  /// From now on replaces `words` in what the server sends by `others`, which must have the same length.
  void replace(std::string words, std::string others);
  /// Inserts these bytes into what the server sends to each client.
  void inject(std::string bytes);
  /// How many connections there were so far.
  int connections() const { return connections_; }
  /// What clients have said so far, one after the other.
  std::string heard() const;

 private:
  struct Pair {
    int client;
    int server;
  };
  void run();
  void accept_one();
  /// \return false if one side has closed the connection
  bool forward(const Pair& pair, bool from_server);

  const std::uint16_t server_port_;
  std::uint16_t port_ = 0;
  int listener_ = -1;
  int wake_ = -1;
  std::atomic<bool> ending_ = false;
  std::atomic<int> connections_ = 0;
  std::vector<Pair> pairs_;  ///< used by the thread
  mutable std::mutex mutex_;
  std::string words_, others_;  ///< guarded by mutex_
  std::string injection_;       ///< guarded by mutex_
  std::string heard_;           ///< guarded by mutex_
  std::thread thread_;
};

}  // namespace iotcloud::tests
