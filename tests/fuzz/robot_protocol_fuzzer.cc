// Hostile bytes for a turtle driver's port, or as answers to an agent: the first byte gives the size of the pieces in
// which the rest comes.
#include <algorithm>
#include <cmath>
#include <span>
#include <string>
#include <vector>

#include "iotcloud/drivers/turtle/robot/protocol.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
namespace robot = drivers::turtle::robot;

namespace {

void read_message(const robot::Incoming& message) try {
  drivers::Payload encoded;
  switch (message.kind) {
    case robot::Kind::hello: {
      const robot::Hello hello = robot::read_hello(message);
      fuzz::must(hello.name.size() <= robot::most_name_bytes, "a name has its limit");
      return;
    }
    case robot::Kind::challenge:
      static_cast<void>(robot::read_challenge(message));
      return;
    case robot::Kind::proof:
      static_cast<void>(robot::read_proof(message));
      return;
    case robot::Kind::refused:
      static_cast<void>(robot::read_refused(message));
      return;
    case robot::Kind::drive: {
      const drivers::turtle::Velocity velocity = robot::read_drive(message);
      fuzz::must(std::isfinite(velocity.linear) && std::isfinite(velocity.angular), "a velocity is finite");
      return;
    }
    case robot::Kind::frame:
      static_cast<void>(robot::read_frame(message, encoded));
      fuzz::must(encoded.size() <= message.body->size(), "a frame is a part of its message");
      return;
    default:
      static_cast<void>(robot::read_number(message));
      return;
  }
} catch (const robot::ProtocolError&) {  // refused
}

/// The kinds and bodies of the messages read until the stream ended or was refused.
std::vector<std::string> messages_of(std::span<const std::byte> stream, std::size_t piece) {
  std::vector<std::string> found;
  robot::MessageReader reader(robot::most_to_agent);
  try {
    for (std::size_t at = 0; at < stream.size(); at += piece) {
      auto bytes = stream.subspan(at, std::min(piece, stream.size() - at));
      while (const auto message = reader.take(bytes)) {
        fuzz::must(message->body->size() < robot::most_to_agent, "a message has its limit");
        found.push_back(static_cast<char>(message->kind) +
                        std::string(reinterpret_cast<const char*>(message->body->data()), message->body->size()));
        read_message(*message);
      }
    }
  } catch (const robot::ProtocolError&) {  // refused
    found.push_back("refused");
  }
  return found;
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(robot_protocol, 10'000) {
  if (size == 0) return;
  const auto stream = std::as_bytes(std::span(data + 1, size - 1));
  const std::size_t piece = 1 + data[0] % 40;
  fuzz::must(messages_of(stream, piece) == messages_of(stream, std::max<std::size_t>(stream.size(), 1)),
             "what comes in pieces is what comes at once");
}
