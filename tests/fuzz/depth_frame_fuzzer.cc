// Depth frames from a broker: anybody who may publish there can write one, with a valid checksum.
#include <cstring>
#include <span>
#include <vector>

#include <zlib.h>

#include "iotcloud/drivers/depth/depth_codec.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
namespace depth = drivers::depth;

namespace {

/// A tagged frame with this codec and body, and the checksum that belongs to them.
std::vector<std::byte> signed_frame(std::uint8_t codec, const std::uint8_t* body, std::size_t size) {
  auto sum = crc32(0, &codec, 1);
  sum = crc32(sum, body, static_cast<uInt>(size));
  std::vector<std::byte> frame(8 + size);
  std::memcpy(frame.data(), "IDC", 3);
  frame[3] = std::byte{codec};
  for (int i = 0; i < 4; ++i) frame[4 + i] = static_cast<std::byte>(sum >> (8 * i) & 0xff);
  if (size > 0) std::memcpy(frame.data() + 8, body, size);
  return frame;
}

/// Decoding must not depend on earlier frames, and a refused frame must leave no trace.
void decode_twice(std::span<const std::byte> payload) {
  static depth::DepthDecoder used;
  depth::DepthDecoder fresh;
  std::vector<std::uint16_t> once(depth::frame_pixels, 1), again(depth::frame_pixels, 1);
  const depth::DecodeError error = used.decode(payload, depth::FrameSpan(once));
  fuzz::must(fresh.decode(payload, depth::FrameSpan(again)) == error, "a frame is refused twice or never");
  fuzz::must(once == again, "a frame is decoded to the same depths");
  if (error != depth::DecodeError::none) fuzz::must(once[0] == 1, "a refused frame leaves what was there");
  const depth::DecodeError of_disparities = used.decode_disparities(payload, depth::FrameSpan(once));
  if (of_disparities != depth::DecodeError::none) return;
  for (const std::uint16_t disparity : once) fuzz::must(disparity < 2048, "a disparity has eleven bits");
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(depth_frame, 100) {
  decode_twice(std::as_bytes(std::span(data, size)));
  if (size > 0) decode_twice(signed_frame(1 + data[0] % 2, data + 1, size - 1));
}
