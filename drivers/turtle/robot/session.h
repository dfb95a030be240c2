#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include <boost/asio/io_context.hpp>

#include <iotcloud/drivers/turtle/robot/protocol.h>

namespace iotcloud::drivers::turtle::robot {

struct SessionOptions {
  std::string host, port, token, name;
  std::chrono::milliseconds silence{250};
  std::chrono::milliseconds handshake{3'000};  ///< for connecting and the driver's proof
};

/// The agent's end of one connection, from the look-up of the driver's address to the end: hand-shake, heartbeats,
/// messages. The loop's thread makes all calls.
class Session {
 public:
  struct Handlers {
    std::function<void()> on_open;                    ///< the driver has proved that it knows the token
    std::function<void(const Incoming&)> on_message;  ///< called after on_open; may throw ProtocolError
    std::function<void(const std::string&)> on_end;   ///< called once, with the reason; never from inside send()
  };
  /// Connects at once. Handlers are not called after the destructor, and may destroy this object.
  Session(boost::asio::io_context& loop, const SessionOptions& options, Handlers handlers);
  ~Session();
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  /// Call it after on_open. Messages are sent in order.
  void send(std::string head, Payload body = {});

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace iotcloud::drivers::turtle::robot
