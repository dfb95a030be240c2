#pragma once

#include <algorithm>
#include <string>
#include <string_view>

#include "iotcloud/config/error.h"
#include "iotcloud/processes/frames.h"
#include "iotcloud/tests/fuzz/bytes.h"

namespace iotcloud::fuzz {

/// Reads a stream of frames of which two sides send each other messages. The first byte chooses the side that reads,
/// and the size of the pieces in which the rest comes.
/// \param read_one,read_other get the body of each frame
template <typename One, typename Other>
void read_frames(std::string_view input, One&& read_one, Other&& read_other) try {
  if (input.empty()) return;
  const auto first = static_cast<unsigned char>(input.front());
  const std::size_t piece = std::size_t{1} + (first >> 1U);
  std::string_view left = input.substr(1);
  processes::FrameReader reader;
  while (!left.empty()) {
    const auto part = left.substr(0, piece);
    left.remove_prefix(part.size());
    reader.feed(part.data(), part.size());
    while (const auto body = reader.next()) {
      if ((first & 1U) != 0) {
        read_one(*body);
      } else {
        read_other(*body);
      }
    }
  }
} catch (const config::Error&) {  // NOLINT(bugprone-empty-catch): a frame that is too long ends the connection
}

/// Checks that a message that was read can be written, and reads as the same again.
template <typename Decode>
void read_again(const std::string& body, Decode&& decode) try {
  const std::string once = encode(decode(body));
  processes::FrameReader reader;
  reader.feed(once.data(), once.size());
  must(encode(decode(reader.next().value_or(""))) == once, "a message that was read is written and read as the same");
} catch (const config::Error&) {  // NOLINT(bugprone-empty-catch): the reader ends the connection
}

}  // namespace iotcloud::fuzz
