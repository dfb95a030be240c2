#pragma once

#include <memory>
#include <string>

namespace iotcloud::brokers::embedded {

class ServerState;

/// The in-process broker behind all "embedded://NAME" of one name: its queues live as long as any broker, or this
/// handle, uses them. Tests hold a handle to take the server away and bring it back. Thread safe.
class Server {
 public:
  /// The server of that name in this process; made, and running, when nobody uses one yet.
  static Server named(const std::string& name);

  /// As SIGKILL to a real one: connections are lost at once, with them what was under way; only durable topics keep
  /// their queues. Brokers wait and come back by themselves after start().
  void stop();
  void start();
  bool running() const;
  /// Messages that wait in the queue of `topic` and `group`, those handed out but unsettled included.
  std::size_t depth(const std::string& topic, const std::string& group) const;

  /// For the broker objects of this process.
  const std::shared_ptr<ServerState>& state() const { return state_; }

 private:
  explicit Server(std::shared_ptr<ServerState> state) : state_(std::move(state)) {}
  std::shared_ptr<ServerState> state_;
};

}  // namespace iotcloud::brokers::embedded
