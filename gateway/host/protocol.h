#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/metrics.h>
#include <iotcloud/gateway/host/broker_states.h>
#include <iotcloud/gateway/host/channel_looks.h>
#include <iotcloud/gateway/host/instance_spec.h>
#include <iotcloud/gateway/host/passed_message.h>

/// The protocol between a gateway and a driver host process, over a Unix domain socket in the gateway's state folder.
/// The host listens and serves one connection at a time. Who connects must have the user that made the socket, and
/// first prove that it is the gateway that started the host, or a later run of it; the host closes the connections of
/// others. Every frame (processes/frames.h) is JSON. The host first sends a hello report, so that a restarted gateway
/// knows what runs. A host goes on when its gateway ends.
namespace iotcloud::gateway::protocol {

/// Increased with every incompatible change. A gateway ends a host that has another version instead of adopting it.
inline constexpr int version = 5;

/// A message from the gateway.
struct HostCommand {
  enum class Kind { create, activate, deactivate, remove, shutdown, ping, metrics, deliver, answer, renew, ask, prove };
  Kind kind = Kind::ping;
  discovery::InstanceId instance;    ///< activate, deactivate, remove
  std::optional<InstanceSpec> spec;  ///< create
  /// remove: 1 if the instance is undeployed; shutdown: the limit in milliseconds; ping: repeated in the pong; answer:
  /// see there; renew: when the registry confirmed the gateway's place, in nanoseconds of this machine's monotonic
  /// clock.
  std::int64_t number = 0;
  PassedMessage passed{};      ///< deliver: a message that another host read
  PassAnswer answer{};         ///< answer: to the message that the host has passed under that number
  ChannelQuestion question{};  ///< ask: `number` is in the answer
  std::string proof{};         ///< prove: what only this host's gateway knows (HostProofs); its first command
};

/// A message from the host.
struct HostReport {
  enum class Kind { hello, refused, status, pong, metrics, pass, answer, told };
  Kind kind = Kind::pong;
  int version = protocol::version;        ///< hello
  HostOrder order;                        ///< hello
  bool answers = false;                   ///< hello: it understands HostCommand::Kind::ask, which came later
  std::vector<HostedInstance> instances;  ///< hello
  std::string reason;                     ///< refused: why the plugin cannot be loaded
  InstanceStatus status;                  ///< status
  std::int64_t number = 0;              ///< pong: of the ping; answer: of the delivered message; told: of the question
  std::vector<Stall> stalls;            ///< pong: the event threads that are stuck
  std::vector<BrokerLink> brokers{};    ///< pong
  std::vector<config::Sample> samples;  ///< metrics: all samples of the process
  PassedMessage passed{};               ///< pass: a message for an instance of another host
  PassAnswer answer{};                  ///< answer
  discovery::ChannelLook look{};        ///< told: the answer to the question of that number
};

/// Encodes a complete frame. Bytes that are not UTF-8 are replaced.
std::string encode(const HostCommand& command);
std::string encode(const HostReport& event);
/// The first frame of a connection: HostCommand::Kind::prove.
std::string proof_frame(const std::string& proof);
/// Decodes the body of a frame. \throws config::Error if it is malformed.
HostCommand decode_command(const std::string& body);
HostReport decode_report(const std::string& body);

}  // namespace iotcloud::gateway::protocol
