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

/// Stands between a client and a RabbitMQ server, on loopback, and hands AMQP frames on; counts their methods, and can
/// hold the server's answers up, swallow its confirmations, or withhold messages. Thread safe.
class FrameProxy {
 public:
  /// \param server_url of a server without TLS
  explicit FrameProxy(const std::string& server_url);
  ~FrameProxy();
  FrameProxy(const FrameProxy&) = delete;
  FrameProxy& operator=(const FrameProxy&) = delete;

  const std::string& url() const { return url_; }
  int connections() const { return connections_; }  ///< that were ever made
  /// Frames with this method that the client has sent, or that came from the server and were handed on.
  int seen(amqp_method_number_t method) const;
  amqp_channel_t highest_channel() const { return highest_channel_; }  ///< that a client has opened
  /// From now on nothing that the server says arrives, until release().
  void hold_answers() { holding_ = true; }
  void release_answers() { holding_ = false; }
  /// From now on what the connections that there are publish, and whatever follows it, does not arrive, until
  /// release_messages(): then it does, even when the client has given the connection up.
  void withhold_messages() { withholding_ = true; }
  void release_messages() { withholding_ = false; }
  /// From now on no basic.ack of the server arrives, on any connection.
  void swallow_confirmations(bool swallow) { swallowing_ = swallow; }

 private:
  struct Pair;
  void run();
  void accept_one();
  /// \return false when either side has ended
  bool pass_on(Pair& pair, bool from_server);

  std::string url_;
  int server_port_;
  int listener_;
  std::atomic<int> connections_ = 0;
  std::atomic<amqp_channel_t> highest_channel_ = 0;
  std::atomic<bool> holding_ = false, swallowing_ = false, withholding_ = false, ending_ = false;
  mutable std::mutex mutex_;
  std::map<amqp_method_number_t, int> seen_;  ///< guarded by mutex_
  std::vector<std::unique_ptr<Pair>> pairs_;  ///< the thread's own
  std::thread thread_;
};

}  // namespace iotcloud::brokers
