#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/host/instance_spec.h>

/// What a gateway and a driver host process say to each other over a Unix domain socket in the gateway's state folder.
/// The host listens and keeps one connection at a time; others are closed at once. Every frame is a length of four
/// bytes, most significant first, and that many bytes of JSON. The host greets with Hello, so that a gateway that comes
/// back knows what runs. A host goes on when its gateway is gone.
namespace iotcloud::gateway::protocol {

/// Grows with every change that the other side cannot follow. A host of another version is ended, not adopted.
inline constexpr int version = 2;
inline constexpr std::size_t max_frame = 16u << 20;

/// From the gateway.
struct Command {
  enum class Kind { create, activate, deactivate, remove, shutdown, ping, metrics };
  Kind kind = Kind::ping;
  std::string instance;              ///< activate, deactivate, remove
  std::optional<InstanceSpec> spec;  ///< create
  std::int64_t number = 0;           ///< shutdown: the limit in milliseconds; ping: answered in the pong
};

/// From the host.
struct Event {
  enum class Kind { hello, refused, status, pong, metrics };
  Kind kind = Kind::pong;
  int version = protocol::version;        ///< hello
  HostOrder order;                        ///< hello
  std::vector<HostedInstance> instances;  ///< hello
  std::string reason;                     ///< refused: why the plugin cannot be loaded
  InstanceStatus status;                  ///< status
  std::int64_t number = 0;                ///< pong: of the ping
  std::vector<Stall> stalls;              ///< pong: the event threads that are stuck
  std::vector<config::Sample> samples;    ///< metrics: all of the process
};

/// One whole frame. Text that is not UTF-8 has its bad bytes replaced.
std::string encode(const Command& command);
std::string encode(const Event& event);
/// The body of a frame. \throws config::Error when it is none.
Command decode_command(const std::string& body);
Event decode_event(const std::string& body);

/// Cuts a stream of bytes into frames.
class FrameReader {
 public:
  void feed(const char* bytes, std::size_t size) { buffer_.append(bytes, size); }
  /// The next body, when it is complete. \throws config::Error for a frame longer than `max_frame`.
  std::optional<std::string> next();

 private:
  std::string buffer_;
};

}  // namespace iotcloud::gateway::protocol
