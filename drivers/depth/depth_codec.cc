#include <algorithm>
#include <cmath>
#include <cstring>

#include <snappy.h>
#include <zlib.h>

#include <iotcloud/drivers/depth/depth_codec.h>
#include <iotcloud/drivers/depth/inversion.h>
#include <iotcloud/drivers/depth/plane_codec.h>

namespace iotcloud::drivers::depth {

namespace {

// docs/wire.md#depth-frames. The scale is 10 bits' worth of inverse millimetres; the offset moves 4 m to code 1.
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

std::array<std::uint16_t, 2048> make_disparity_mm_table() {
  std::array<std::uint16_t, 2048> table{};
  for (int d = 0; d < 1023; ++d) table[d] = static_cast<std::uint16_t>(disparity_to_mm(d));
  return table;
}

/// Begins a tagged payload. A payload of the reference codec begins with a frame's length as Snappy writes it; its
/// first byte is always 0x80, so it never looks like a tag.
struct Tag {
  static constexpr std::array<char, 3> mark = {'I', 'D', 'C'};
  static constexpr std::size_t codec_at = 3, checksum_at = 4, size = 8;
};

std::uint32_t checksum(std::span<const std::byte> payload) {
  const auto* bytes = reinterpret_cast<const Bytef*>(payload.data());
  const auto of_codec = crc32_z(0, bytes + Tag::codec_at, 1);
  return static_cast<std::uint32_t>(crc32_z(of_codec, bytes + Tag::size, payload.size() - Tag::size));
}

void write_tag(std::vector<std::byte>& payload, Codec codec) {
  payload.resize(Tag::size);
  std::memcpy(payload.data(), Tag::mark.data(), Tag::mark.size());
  payload[Tag::codec_at] = static_cast<std::byte>(codec);
}

/// Call it last: the sum covers the rest of the payload.
void write_checksum(std::vector<std::byte>& payload) {
  const std::uint32_t sum = checksum(payload);
  for (int i = 0; i < 4; ++i) payload[Tag::checksum_at + i] = static_cast<std::byte>(sum >> (8 * i) & 0xff);
}

bool is_tagged(std::span<const std::byte> payload) {
  return payload.size() >= Tag::mark.size() && std::memcmp(payload.data(), Tag::mark.data(), Tag::mark.size()) == 0;
}

struct Tagged {
  DecodeError error = DecodeError::none;
  Codec codec = Codec::reference;
  std::span<const std::byte> body;
};

/// \pre is_tagged().
Tagged read_tag(std::span<const std::byte> payload) {
  if (payload.size() < Tag::size) return {.error = DecodeError::damaged, .body = {}};
  std::uint32_t sum = 0;
  for (int i = 3; i >= 0; --i) sum = sum << 8 | std::to_integer<std::uint32_t>(payload[Tag::checksum_at + i]);
  if (sum != checksum(payload)) return {.error = DecodeError::damaged, .body = {}};
  const auto codec = static_cast<Codec>(payload[Tag::codec_at]);
  const bool known = codec == Codec::compact || codec == Codec::lossless;
  return {known ? DecodeError::none : DecodeError::unknown_codec, codec, payload.subspan(Tag::size)};
}

IOTCLOUD_PIXEL_LOOP void to_eleven_bits(const std::uint16_t* from, std::uint16_t* to) {
  for (std::size_t i = 0; i < frame_pixels; ++i) to[i] = from[i] < no_reading ? from[i] : no_reading;
}

IOTCLOUD_PIXEL_LOOP void disparities_to_mm(const std::uint16_t* disparities, const std::uint16_t* table,
                                           std::uint16_t* mm) {
  for (std::size_t i = 0; i < frame_pixels; ++i) mm[i] = table[disparities[i] & no_reading];
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

const std::array<std::uint16_t, 2048>& disparity_mm_table() {
  static const auto table = make_disparity_mm_table();
  return table;
}

std::optional<Codec> codec_named(std::string_view name) {
  const auto found = std::find(codec_names.begin(), codec_names.end(), name);
  if (found == codec_names.end()) return std::nullopt;
  return static_cast<Codec>(found - codec_names.begin());
}

DepthEncoder::DepthEncoder(Codec codec) : codec_(codec) {
  if (codec != Codec::lossless) codes_.resize(frame_pixels);
  switch (codec) {
    case Codec::reference:
      payload_.resize(snappy::MaxCompressedLength(frame_pixels));
      break;
    case Codec::compact:
      compact_ = std::make_unique<groups::PlaneEncoder<groups::CodePlane>>();
      break;
    case Codec::lossless:
      disparities_.resize(frame_pixels);
      lossless_ = std::make_unique<groups::PlaneEncoder<groups::DisparityPlane>>();
      break;
  }
}

DepthEncoder::~DepthEncoder() = default;
DepthEncoder::DepthEncoder(DepthEncoder&&) noexcept = default;
DepthEncoder& DepthEncoder::operator=(DepthEncoder&&) noexcept = default;

std::span<const std::byte> DepthEncoder::encode(FrameView disparities) {
  if (codec_ == Codec::reference) {
    to_codes(best_path(), disparities, codes_.data());
    std::size_t size = 0;
    snappy::RawCompress(reinterpret_cast<const char*>(codes_.data()), frame_pixels,
                        reinterpret_cast<char*>(payload_.data()), &size);
    return std::span(payload_).first(size);
  }
  write_tag(payload_, codec_);
  if (codec_ == Codec::compact) {
    to_codes(best_path(), disparities, codes_.data());
    compact_->encode(codes_.data(), payload_);
  } else {
    to_eleven_bits(disparities.data(), disparities_.data());
    lossless_->encode(disparities_.data(), payload_);
  }
  write_checksum(payload_);
  return payload_;
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
    case DecodeError::unknown_codec:
      return "a depth frame of a codec that this program does not know; it knows reference, compact and lossless";
    case DecodeError::damaged:
      return "a depth frame that is cut off or damaged: its checksum is wrong";
    case DecodeError::malformed:
      return "a depth frame with a right checksum that no encoder wrote";
    case DecodeError::not_lossless:
      return "a depth frame without disparities; they are in frames of the codec \"lossless\" only";
  }
  return "an unknown error";
}

DepthDecoder::DepthDecoder()
    : codes_(frame_pixels),
      disparities_(frame_pixels),
      compact_(std::make_unique<groups::PlaneDecoder<groups::CodePlane>>()),
      lossless_(std::make_unique<groups::PlaneDecoder<groups::DisparityPlane>>()) {}

DepthDecoder::~DepthDecoder() = default;
DepthDecoder::DepthDecoder(DepthDecoder&&) noexcept = default;
DepthDecoder& DepthDecoder::operator=(DepthDecoder&&) noexcept = default;

DecodeError DepthDecoder::decode(std::span<const std::byte> payload, FrameSpan mm) noexcept {
  if (!is_tagged(payload)) {
    const DecodeError error = decode_reference(payload);
    if (error == DecodeError::none) to_mm(best_path(), codes_.data(), mm);
    return error;
  }
  const Tagged tagged = read_tag(payload);
  if (tagged.error != DecodeError::none) return tagged.error;
  if (tagged.codec == Codec::compact) {
    if (!compact_->decode(tagged.body, codes_.data())) return DecodeError::malformed;
    to_mm(best_path(), codes_.data(), mm);
  } else {
    if (!lossless_->decode(tagged.body, disparities_.data())) return DecodeError::malformed;
    disparities_to_mm(disparities_.data(), disparity_mm_table().data(), mm.data());
  }
  return DecodeError::none;
}

DecodeError DepthDecoder::decode_disparities(std::span<const std::byte> payload, FrameSpan disparities) noexcept {
  if (!is_tagged(payload)) return DecodeError::not_lossless;
  const Tagged tagged = read_tag(payload);
  if (tagged.error != DecodeError::none) return tagged.error;
  if (tagged.codec != Codec::lossless) return DecodeError::not_lossless;
  if (!lossless_->decode(tagged.body, disparities_.data())) return DecodeError::malformed;
  to_eleven_bits(disparities_.data(), disparities.data());
  return DecodeError::none;
}

DecodeError DepthDecoder::decode_reference(std::span<const std::byte> payload) {
  const char* bytes = reinterpret_cast<const char*>(payload.data());
  std::size_t declared = 0;
  if (!snappy::GetUncompressedLength(bytes, payload.size(), &declared)) return DecodeError::not_snappy;
  if (declared < frame_pixels) return DecodeError::too_short;
  if (declared > frame_pixels) return DecodeError::too_long;
  const bool whole = snappy::RawUncompress(bytes, payload.size(), reinterpret_cast<char*>(codes_.data()));
  return whole ? DecodeError::none : DecodeError::not_snappy;
}

}  // namespace iotcloud::drivers::depth
