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

/// The driver's end of a connection: messages in and out over a socket that never blocks, and heartbeats. Of the
/// instance's event thread.
class Connection {
 public:
  struct Handlers {
    std::function<void(const Incoming&)> on_message;  ///< may throw ProtocolError: the connection ends
    std::function<void(const std::string&)> on_end;   ///< once, with the reason; never from inside send()
  };
  /// Takes the socket over. Handlers are not called after the destructor, and may destroy this object.
  /// \param silence without a word of the other side for so long it ends.
  Connection(DriverContext& context, int socket, std::chrono::milliseconds silence, Handlers handlers);
  ~Connection();
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// Sends, or keeps what the socket does not take now; with more than 16 KiB kept the connection ends soon.
  void send(const std::string& message);
  /// The other side has proved who it is: from now on longer messages come, handled by others, and it hears something
  /// from here well within `silence_of_peer`.
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
  const std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);  ///< false: the object is gone, or has ended
  MessageReader reader_{most_before_proof};
  std::string unsent_;
  int silent_ticks_ = 0;
  HandlerId readable_ = 0;
  std::optional<HandlerId> writable_, ticks_, beats_;
};

}  // namespace iotcloud::drivers::turtle::robot
