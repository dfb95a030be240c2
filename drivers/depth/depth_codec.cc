#include <cmath>

#include <snappy.h>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/depth/inversion.h>

namespace iotcloud::drivers::depth {

namespace {

// REFERENCE.md 6. The scale is 10 bits' worth of inverse millimetres; the offset moves 4 m to code 1.
constexpr int code_scale = 90300;
constexpr double code_offset = 21.575;

std::array<std::uint8_t, 1024> make_code_table() {
  std::array<std::uint8_t, 1024> table{};
  for (int d = first_coded_disparity; d <= last_coded_disparity; ++d) {
    const int inverse = code_scale / disparity_to_mm(d);
    table[d] = static_cast<std::uint8_t>(static_cast<int>(inverse - code_offset));
  }
  return table;
}

std::array<std::uint16_t, 256> make_mm_table() {
  std::array<std::uint16_t, 256> table{};
  for (int code = 1; code < 256; ++code) table[code] = static_cast<std::uint16_t>(code_scale / (code + code_offset));
  return table;
}

}  // namespace

int disparity_to_mm(int disparity) {
  return static_cast<int>(1000 * 0.1236 * std::tan(disparity / 2842.5 + 1.1863));
}

const std::array<std::uint8_t, 1024>& code_table() {
  static const auto table = make_code_table();
  return table;
}

const std::array<std::uint16_t, 256>& mm_table() {
  static const auto table = make_mm_table();
  return table;
}

DepthEncoder::DepthEncoder() : codes_(frame_pixels), compressed_(snappy::MaxCompressedLength(frame_pixels)) {}

std::span<const std::byte> DepthEncoder::encode(FrameView disparities) {
  to_codes(best_path(), disparities, codes_.data());
  std::size_t size = 0;
  snappy::RawCompress(reinterpret_cast<const char*>(codes_.data()), frame_pixels, compressed_.data(), &size);
  return std::as_bytes(std::span(compressed_.data(), size));
}

std::string_view describe(DecodeError error) {
  switch (error) {
    case DecodeError::none:
      return "a depth frame";
    case DecodeError::not_snappy:
      return "not a raw Snappy block, or a damaged one";
    case DecodeError::too_short:
      return "a Snappy block that is shorter than a depth frame";
    case DecodeError::too_long:
      return "a Snappy block that is longer than a depth frame";
  }
  return "an unknown error";
}

DepthDecoder::DepthDecoder() : codes_(frame_pixels) {}

DecodeError DepthDecoder::decode(std::span<const std::byte> payload, FrameSpan mm) noexcept {
  const char* bytes = reinterpret_cast<const char*>(payload.data());
  std::size_t declared = 0;
  if (!snappy::GetUncompressedLength(bytes, payload.size(), &declared)) return DecodeError::not_snappy;
  if (declared < frame_pixels) return DecodeError::too_short;
  if (declared > frame_pixels) return DecodeError::too_long;
  if (!snappy::RawUncompress(bytes, payload.size(), reinterpret_cast<char*>(codes_.data()))) {
    return DecodeError::not_snappy;
  }
  to_mm(best_path(), codes_.data(), mm);
  return DecodeError::none;
}

}  // namespace iotcloud::drivers::depth
