// Hostile bytes for a device's stream: the first byte says how frames end, the second how large the pieces are in which
// the rest comes.
#include <algorithm>
#include <span>
#include <string>
#include <vector>

#include "iotcloud/drivers/stream/framing.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
namespace stream = drivers::stream;

namespace {

stream::FramingOptions options_of(std::uint8_t byte) {
  constexpr std::size_t kinds = 4;
  stream::FramingOptions options;
  options.kind = static_cast<stream::Framing>(byte % kinds);
  options.delimiter = (byte & 8) != 0 ? "\r\n" : "\n";
  options.length_bytes = std::size_t{1} << (byte >> 4) % 3;
  options.little_endian = (byte & 0x40) != 0;
  options.length_counts_itself = (byte & 0x80) != 0;
  options.most_bytes = 40;
  return options;
}

/// The frames until the stream ended or could not be followed, and how many were left out.
std::vector<std::string> frames_in(const stream::FramingOptions& options, std::span<const std::byte> bytes,
                                   std::size_t piece) {
  std::vector<std::string> found;
  stream::FrameDecoder decoder(options);
  try {
    for (std::size_t at = 0; at < bytes.size(); at += piece) {
      decoder.feed(bytes.subspan(at, std::min(piece, bytes.size() - at)));
      while (const auto frame = decoder.next()) {
        fuzz::must(frame->size() <= options.most_bytes, "a frame has its limit");
        found.emplace_back(frame->text());
      }
    }
  } catch (const stream::FramingError&) {
    found.emplace_back("refused");
  }
  found.push_back(std::to_string(decoder.refused()));
  return found;
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(framing, 20'000) {
  if (size < 2) return;
  const stream::FramingOptions options = options_of(data[0]);
  const auto bytes = std::as_bytes(std::span(data + 2, size - 2));
  const auto frames = frames_in(options, bytes, std::max<std::size_t>(bytes.size(), 1));
  fuzz::must(frames == frames_in(options, bytes, 1 + data[1] % 40), "what comes in pieces is what comes at once");
  for (const std::string& frame : frames) {
    const std::string again = stream::framed(options, std::as_bytes(std::span(frame)));
    if (frame.empty() && options.kind == stream::Framing::slip) continue;
    fuzz::must(
        frames_in(options, std::as_bytes(std::span(again)), again.size()) == std::vector{frame, std::string("0")},
        "a frame that came is one that can be sent");
  }
}
