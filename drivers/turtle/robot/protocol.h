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

/// What the agent on a robot's laptop (iotcloud-robot) and the turtle driver in a gateway say to each other over one
/// TCP connection. A message is its length (4 bytes: of all that follows them), its kind (1 byte) and its body.
/// Integers are big-endian, numbers IEEE 754 doubles in the same order. README.md has the course of a connection.
/// Nothing that is read is trusted: what is no message throws ProtocolError, and the connection ends.
namespace iotcloud::drivers::turtle::robot {

inline constexpr std::uint16_t protocol_version = 1;
inline constexpr std::size_t proof_bytes = 32;
inline constexpr std::size_t most_name_bytes = 64;
/// Longest message, by what it may be: before the other side has proved that it knows the token, then from agent to
/// driver (frames), and from driver to agent.
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
  refused = 4,    ///< driver: text, why it closes the connection
  start = 5,      ///< driver: send frames
  stop = 6,       ///< driver: send no more
  frame = 7,      ///< agent: FrameHead and the encoded frame
  got = 8,        ///< driver: the number of a frame that came whole; so many may be under way
  drive = 9,      ///< driver: Velocity
  halt = 10,      ///< driver: stop the base
  answered = 11,  ///< driver: the number of the newest frame, which has its command
  alive = 12,     ///< both: nothing else to say
};

using Nonce = std::array<std::byte, 32>;
using Proof = std::array<std::byte, proof_bytes>;

struct Hello {
  std::uint16_t version = protocol_version;
  std::uint32_t silence_ms = 0;  ///< the agent gives the connection up when it hears nothing for so long
  Nonce nonce{};
  std::string name;  ///< for people
};

struct Challenge {
  std::uint32_t silence_ms = 0;  ///< the same of the driver
  Nonce nonce{};
  Proof proof{};  ///< that the driver knows the token
};

struct FrameHead {
  std::uint64_t number = 0;  ///< from 1, of this agent's life; a frame that is sent again keeps its number
  std::uint32_t age_us = 0;  ///< from the capture until it was sent
  double device_time_s = 0;
  bool repeated = false;             ///< see DepthFrame
  bool lock_step = false;            ///< see DepthSource
  std::optional<GroundTruth> truth;  ///< of a simulated world
};

std::string write_hello(const Hello& hello);
std::string write_challenge(const Challenge& challenge);
std::string write_proof(const Proof& proof);
std::string write_refused(std::string_view reason);
std::string write_drive(const Velocity& velocity);
std::string write_number(Kind kind, std::uint64_t number);  ///< got, answered
std::string write_bare(Kind kind);                          ///< start, stop, halt, alive
/// Everything before the encoded frame, which follows as it is.
std::string write_frame_head(const FrameHead& head, std::size_t encoded_bytes);

/// A message as it came. The body may be shared on: a frame is not copied.
struct Incoming {
  Kind kind{};
  std::shared_ptr<const std::vector<std::byte>> body;
};

Hello read_hello(const Incoming& message);
Challenge read_challenge(const Incoming& message);
Proof read_proof(const Incoming& message);
std::string read_refused(const Incoming& message);  ///< printable
Velocity read_drive(const Incoming& message);       ///< finite
std::uint64_t read_number(const Incoming& message);
FrameHead read_frame(const Incoming& message, Payload& encoded);

/// Cuts a stream into messages. Takes memory for a message only up to its limit. Not thread safe.
class MessageReader {
 public:
  explicit MessageReader(std::size_t most_bytes) : most_bytes_(most_bytes) {}
  void set_limit(std::size_t most_bytes) { most_bytes_ = most_bytes; }
  /// The next whole message, taken from the front of `bytes` and what came before; nothing when it takes more.
  /// \throws ProtocolError for a length of 0 or beyond the limit.
  std::optional<Incoming> take(std::span<const std::byte>& bytes);

 private:
  std::size_t most_bytes_;
  std::array<std::byte, 5> head_{};
  std::size_t head_has_ = 0, body_has_ = 0;
  std::shared_ptr<std::vector<std::byte>> body_;
};

enum class Side { agent, driver };

/// That this side knows the token: HMAC-SHA-256 over both nonces and the side. \throws std::runtime_error when the
/// cryptographic library does.
Proof make_proof(Side side, std::string_view token, const Nonce& of_agent, const Nonce& of_driver);
/// In a time that does not depend on the bytes.
bool same_proof(const Proof& a, const Proof& b);
Nonce random_nonce();

}  // namespace iotcloud::drivers::turtle::robot
