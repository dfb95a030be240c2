#pragma once

#include <memory>
#include <string>

namespace iotcloud::brokers::embedded {

class ServerState;

/// A handle on the in-process broker that all "embedded://NAME" URLs of one name share. The broker and its queues live
/// as long as a handle or a Broker object uses them. Tests hold a handle to stop the server and start it again. Thread
/// safe.
class Server {
 public:
  /// The server of that name in this process; makes a running one if there is none.
  static Server named(const std::string& name);

  /// Acts like SIGKILL on a real server: connections are lost at once, and only durable topics keep their queues.
  /// Unsettled messages go back to their queues. Broker objects wait, and reconnect after start().
  void stop();
  void start();
  bool running() const;
  /// The number of messages in the queue of `topic` and `group`, including unsettled ones.
  std::size_t depth(const std::string& topic, const std::string& group) const;

  /// Whether there is a queue of `topic` and `group`, which may be empty.
  bool has_queue(const std::string& topic, const std::string& group) const;

  /// For the broker objects of this process.
  const std::shared_ptr<ServerState>& state() const { return state_; }

 private:
  explicit Server(std::shared_ptr<ServerState> state) : state_(std::move(state)) {}
  std::shared_ptr<ServerState> state_;
};

}  // namespace iotcloud::brokers::embedded
