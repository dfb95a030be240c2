#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <amqp.h>

namespace iotcloud::brokers {

/// A proxy between a client and a RabbitMQ server on loopback. It passes on AMQP frames and counts their methods, and
/// can delay the server's answers, swallow its confirmations, or withhold messages. Thread safe.
class FrameProxy {
 public:
  enum class Buffers { usual, small };
  /// \param server_url of a server without TLS \param buffers between client and proxy: small ones hold some 100 KB of
  /// what the client says
  explicit FrameProxy(const std::string& server_url, Buffers buffers = Buffers::usual);
  ~FrameProxy();
  FrameProxy(const FrameProxy&) = delete;
  FrameProxy& operator=(const FrameProxy&) = delete;

  const std::string& url() const { return url_; }
  int connections() const { return connections_; }  ///< made so far
  /// How many frames with this method the client sent, or the server sent and the proxy passed on.
  int seen(amqp_method_number_t method) const;
  amqp_channel_t highest_channel() const { return highest_channel_; }  ///< opened by a client so far
  /// Delays everything that the server sends, until release_answers().
  void hold_answers() { holding_ = true; }
  void release_answers() { holding_ = false; }
  /// Delays published messages of the present connections, and all that follows them, until release_messages(): then
  /// they arrive, even if the client has given up the connection.
  void withhold_messages() { withholding_ = true; }
  void release_messages() { withholding_ = false; }
  /// Stops reading what clients send, until take_again().
  void stop_taking() { taking_ = false; }
  void take_again() { taking_ = true; }
  /// Drops every basic.ack of the server, on all connections.
  void swallow_confirmations(bool swallow) { swallowing_ = swallow; }

 private:
  struct Pair;
  void run();
  void accept_one();
  /// \return false if either side has ended
  bool pass_on(Pair& pair, bool from_server);

  std::string url_;
  int server_port_;
  int listener_;
  std::atomic<int> connections_ = 0;
  std::atomic<amqp_channel_t> highest_channel_ = 0;
  std::atomic<bool> holding_ = false, swallowing_ = false, withholding_ = false, taking_ = true, ending_ = false;
  mutable std::mutex mutex_;
  std::map<amqp_method_number_t, int> seen_;  ///< guarded by mutex_
  std::vector<std::unique_ptr<Pair>> pairs_;  ///< used by the thread
  std::thread thread_;
};

}  // namespace iotcloud::brokers
