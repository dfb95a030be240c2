// What a driver host sends its gateway, and the other way round: a stream of frames. The first byte chooses the side
// that reads it, and the size of the pieces in which it comes.
#include <algorithm>
#include <string>
#include <string_view>

#include "iotcloud/config/error.h"
#include "iotcloud/gateway/host/protocol.h"
#include "iotcloud/processes/frames.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
namespace host = gateway::protocol;

namespace {

std::string body_of(const std::string& frame) {
  processes::FrameReader reader;
  reader.feed(frame.data(), frame.size());
  return reader.next().value_or("");
}

/// What was read can be written and read again as the same.
template <typename Decode>
void read_again(const std::string& body, Decode&& decode) try {
  const std::string once = encode(decode(body));
  fuzz::must(encode(decode(body_of(once))) == once, "a message that was read is written and read as the same");
} catch (const config::Error&) {  // NOLINT(bugprone-empty-catch): the reader ends the connection
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(host_protocol, 10'000) {
  if (size == 0) return;
  const bool to_gateway = (*data & 1U) != 0;
  const std::size_t piece = std::size_t{1} + (*data >> 1U);
  std::string_view left = fuzz::text(data + 1, size - 1);
  processes::FrameReader reader;
  try {
    while (!left.empty()) {
      const auto part = left.substr(0, piece);
      left.remove_prefix(part.size());
      reader.feed(part.data(), part.size());
      while (const auto body = reader.next()) {
        if (to_gateway) {
          read_again(*body, host::decode_report);
        } else {
          read_again(*body, host::decode_command);
        }
      }
    }
  } catch (const config::Error&) {  // NOLINT(bugprone-empty-catch): a frame that is too long ends the connection
  }
}
