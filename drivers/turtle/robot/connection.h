#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/turtle/robot/protocol.h>

namespace iotcloud::drivers::turtle::robot {

/// The driver's end of a connection: sends and receives messages and heartbeats over a socket that never blocks. The
/// instance's event thread makes all calls.
class Connection {
 public:
  struct Handlers {
    std::function<void(const Incoming&)> on_message;  ///< may throw ProtocolError, which ends the connection
    std::function<void(const std::string&)> on_end;   ///< called once, with the reason; never from inside send()
  };
  /// Owns the socket from now on. Handlers are not called after the destructor, and may destroy this object.
  /// \param silence the connection ends when the other side sends nothing for this long.
  Connection(DriverContext& context, int socket, std::chrono::milliseconds silence, Handlers handlers);
  ~Connection();
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// Sends the message, or keeps what the socket does not take now. The connection ends soon once it keeps more than 16
  /// KiB.
  void send(const std::string& message);
  /// Must be called when the other side has proved that it knows the token. From now on messages may have `most_bytes`
  /// and go to `handlers`, and heartbeats keep the gap between two messages well below `silence_of_peer`.
  void establish(std::size_t most_bytes, std::chrono::milliseconds silence, std::chrono::milliseconds silence_of_peer,
                 Handlers handlers);

 private:
  void read();
  void write();
  void watch_silence(std::chrono::milliseconds silence);
  void tick();
  void end(const std::string& reason);

  DriverContext& context_;
  const int socket_;
  Handlers handlers_;
  /// false: the connection has ended or the object is destroyed
  const std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);
  MessageReader reader_{most_before_proof};
  std::string unsent_;
  int silent_ticks_ = 0;
  HandlerId readable_ = 0;
  std::optional<HandlerId> writable_, ticks_, beats_;
};

}  // namespace iotcloud::drivers::turtle::robot
