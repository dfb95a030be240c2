#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include <iotcloud/drivers/turtle/device.h>

/// The protocol between the agent on a robot's laptop (iotcloud-robot) and the turtle driver in a gateway, over one TCP
/// connection. A message is a length (4 bytes: of the rest), a kind (1 byte) and a body. Integers are big-endian,
/// numbers are IEEE 754 doubles in the same order. README.md describes a connection's course. Readers trust nothing:
/// for anything else they throw ProtocolError, and the connection ends.
namespace iotcloud::drivers::turtle::robot {

inline constexpr std::uint16_t protocol_version = 1;
inline constexpr std::size_t proof_bytes = 32;
inline constexpr std::size_t most_name_bytes = 64;
/// The longest message: before the other side has proved that it knows the token, from agent to driver (frames), and
/// from driver to agent.
inline constexpr std::size_t most_before_proof = 256;
inline constexpr std::size_t most_to_driver = std::size_t{1} << 20;
inline constexpr std::size_t most_to_agent = 1024;

class ProtocolError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

enum class Kind : std::uint8_t {
  hello = 1,      ///< agent: Hello, first
  challenge = 2,  ///< driver: Challenge
  proof = 3,      ///< agent: 32 bytes, which end the hand-shake
  refused = 4,    ///< driver: text: why it closes the connection
  start = 5,      ///< driver: the agent shall send frames
  stop = 6,       ///< driver: the agent shall send no more frames
  frame = 7,      ///< agent: FrameHead and the encoded frame
  got = 8,        ///< driver: the number of a frame that has arrived; the agent limits how many lack one
  drive = 9,      ///< driver: Velocity
  halt = 10,      ///< driver: stop the base
  answered = 11,  ///< driver: the number of the newest frame, whose command was sent
  alive = 12,     ///< both: a heartbeat
};

using Nonce = std::array<std::byte, 32>;
using Proof = std::array<std::byte, proof_bytes>;

struct Hello {
  std::uint16_t version = protocol_version;
  std::uint32_t silence_ms = 0;  ///< the agent gives up the connection when it receives nothing for this long
  Nonce nonce{};
  std::string name;  ///< for the log
};

struct Challenge {
  std::uint32_t silence_ms = 0;  ///< the driver gives up the connection when it receives nothing for this long
  Nonce nonce{};
  Proof proof{};  ///< proves that the driver knows the token
};

struct FrameHead {
  std::uint64_t number = 0;  ///< counts from 1 while the agent runs; a repeated frame keeps its number
  std::uint32_t age_us = 0;  ///< from capture to sending
  double device_time_s = 0;
  bool repeated = false;             ///< see DepthFrame
  bool lock_step = false;            ///< see DepthSource
  std::optional<GroundTruth> truth;  ///< if the frame comes from a simulated world
};

std::string write_hello(const Hello& hello);
std::string write_challenge(const Challenge& challenge);
std::string write_proof(const Proof& proof);
std::string write_refused(std::string_view reason);
std::string write_drive(const Velocity& velocity);
std::string write_number(Kind kind, std::uint64_t number);  ///< got, answered
std::string write_bare(Kind kind);                          ///< start, stop, halt, alive
/// The part before the encoded frame, which the caller sends after it.
std::string write_frame_head(const FrameHead& head, std::size_t encoded_bytes);

/// A received message. Its body is shared, so that a frame is never copied.
struct Incoming {
  Kind kind{};
  std::shared_ptr<const std::vector<std::byte>> body;
};

Hello read_hello(const Incoming& message);
Challenge read_challenge(const Incoming& message);
Proof read_proof(const Incoming& message);
std::string read_refused(const Incoming& message);  ///< the text with printable characters only
Velocity read_drive(const Incoming& message);       ///< finite
std::uint64_t read_number(const Incoming& message);
FrameHead read_frame(const Incoming& message, Payload& encoded);

/// Cuts a stream into messages. Allocates memory for a message up to the limit only. Not thread safe.
class MessageReader {
 public:
  explicit MessageReader(std::size_t most_bytes) : most_bytes_(most_bytes) {}
  void set_limit(std::size_t most_bytes) { most_bytes_ = most_bytes; }
  /// Takes bytes from the front of `bytes`. \return a message when it is complete, otherwise nothing.
  /// \throws ProtocolError for a length of 0 or beyond the limit.
  std::optional<Incoming> take(std::span<const std::byte>& bytes);

 private:
  std::size_t most_bytes_;
  std::array<std::byte, 5> head_{};
  std::size_t head_has_ = 0, body_has_ = 0;
  std::shared_ptr<std::vector<std::byte>> body_;
};

enum class Side { agent, driver };

/// Proves that this side knows the token: HMAC-SHA-256 over both nonces and the side. \throws std::runtime_error if
/// OpenSSL fails.
Proof make_proof(Side side, std::string_view token, const Nonce& of_agent, const Nonce& of_driver);
/// Compares in constant time.
bool same_proof(const Proof& a, const Proof& b);
Nonce random_nonce();

}  // namespace iotcloud::drivers::turtle::robot
