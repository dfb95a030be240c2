#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

/// Codecs for depth frames: 11-bit Kinect disparities in, a compressed payload, millimetres out. README.md compares
/// them. Every payload stands for itself, so a frame that is dropped, late or damaged costs that frame only.
namespace iotcloud::drivers::depth {

inline constexpr std::size_t frame_width = 640;
inline constexpr std::size_t frame_height = 480;
inline constexpr std::size_t frame_pixels = frame_width * frame_height;

/// The sensor's 11-bit value for "no reading". Values from 1023 on mean no reading too.
inline constexpr std::uint16_t no_reading = 2047;
/// Disparities outside this range are coded as 0 = no reading.
inline constexpr std::uint16_t first_coded_disparity = 61;
inline constexpr std::uint16_t last_coded_disparity = 1011;

/// Pinhole intrinsics of the sensor in pixels (docs/wire.md#follower).
inline constexpr double principal_x = 320;
inline constexpr double principal_y = 240;
inline constexpr double focal_length = 600;

/// Row by row from the top left; values are disparities, or millimetres with 0 = no reading.
using FrameView = std::span<const std::uint16_t, frame_pixels>;
using FrameSpan = std::span<std::uint16_t, frame_pixels>;

/// Millimetres for a disparity: trunc(1000 * 0.1236 * tan(d / 2842.5 + 1.1863)), for d <= 1083 (there the tangent
/// ends). Grows with d.
int disparity_to_mm(int disparity);

/// The code of each disparity 0..1023; 0 outside first_coded_disparity..last_coded_disparity. Thread safe.
const std::array<std::uint8_t, 1024>& code_table();

/// Millimetres for each disparity 0..2047 of a lossless frame: disparity_to_mm(), and 0 from 1023 on. Thread safe.
const std::array<std::uint16_t, 2048>& disparity_mm_table();

/// Millimetres for a code, trunc(90300 / (code + 21.575)); 0 stays 0 = no reading. Thread safe.
const std::array<std::uint16_t, 256>& mm_table();

/// How a frame is compressed. A payload says which it is, so decoders need not be told.
enum class Codec {
  /// The original's (docs/wire.md#depth-frames): disparities become one byte a pixel (the inversion step: a code that
  /// is linear in disparity and coarse in depth), then raw-block Snappy. Lossy by design: the far end of the range has
  /// few codes.
  reference,
  compact,   ///< the same codes in at most a third of the bytes
  lossless,  ///< keeps every disparity from 0 to 2047
};
/// "reference", "compact", "lossless", in the order of the enumeration.
inline constexpr std::array<std::string_view, 3> codec_names = {"reference", "compact", "lossless"};
/// The codec of a name in codec_names; nullopt: there is none.
std::optional<Codec> codec_named(std::string_view name);

namespace groups {
struct CodePlane;
struct DisparityPlane;
template <typename Plane>
class PlaneEncoder;
template <typename Plane>
class PlaneDecoder;
}  // namespace groups

/// Compresses frames. Reuses its buffers: make one object for each stream of frames. Not thread safe.
class DepthEncoder {
 public:
  explicit DepthEncoder(Codec codec = Codec::reference);
  ~DepthEncoder();
  DepthEncoder(DepthEncoder&&) noexcept;
  DepthEncoder& operator=(DepthEncoder&&) noexcept;

  /// \param disparities any 16-bit values: values that are no disparity of the sensor count as no reading (2047 in a
  /// lossless frame, which keeps 1023 to 2046 apart).
  /// \return the compressed frame, valid until the next call or the destructor. Never fails. After a few frames it
  /// allocates no memory, except that Snappy takes a hash table of some 200 KB during the call.
  std::span<const std::byte> encode(FrameView disparities);

 private:
  Codec codec_;
  std::vector<std::uint8_t> codes_;
  std::vector<std::uint16_t> disparities_;
  std::vector<std::byte> payload_;
  std::unique_ptr<groups::PlaneEncoder<groups::CodePlane>> compact_;
  std::unique_ptr<groups::PlaneEncoder<groups::DisparityPlane>> lossless_;
};

/// The faults of a payload.
enum class DecodeError {
  none,
  not_snappy,     ///< neither tagged nor a raw Snappy block, or a block that is cut off or damaged
  too_short,      ///< a Snappy block of fewer bytes than a frame has pixels
  too_long,       ///< a Snappy block that claims more bytes
  unknown_codec,  ///< tagged as a frame of a codec that this program does not know
  damaged,        ///< a tagged frame that is cut off or has a wrong checksum
  malformed,      ///< a tagged frame with a right checksum that no encoder writes
  not_lossless,   ///< the caller asked for disparities, which only lossless frames have
};

/// For logs: "not a raw Snappy block".
std::string_view describe(DecodeError error);

/// Decompresses frames from anywhere; the payload itself names its codec. The decoder trusts nothing in it: it reads no
/// byte outside it, and no length in it makes the decoder allocate memory. It keeps nothing of a frame for the next
/// one, only its buffers: make one object for each task. Not thread safe.
class DepthDecoder {
 public:
  DepthDecoder();
  ~DepthDecoder();
  DepthDecoder(DepthDecoder&&) noexcept;
  DepthDecoder& operator=(DepthDecoder&&) noexcept;

  /// Fills `mm` (millimetres, 0 = no reading). On an error `mm` keeps its values. Never throws.
  [[nodiscard]] DecodeError decode(std::span<const std::byte> payload, FrameSpan mm) noexcept;
  /// Fills in the disparities of a lossless frame, exactly as encoded. On an error they keep their values. Never
  /// throws.
  [[nodiscard]] DecodeError decode_disparities(std::span<const std::byte> payload, FrameSpan disparities) noexcept;

 private:
  DecodeError decode_reference(std::span<const std::byte> payload);

  std::vector<std::uint8_t> codes_;
  std::vector<std::uint16_t> disparities_;
  std::unique_ptr<groups::PlaneDecoder<groups::CodePlane>> compact_;
  std::unique_ptr<groups::PlaneDecoder<groups::DisparityPlane>> lossless_;
};

}  // namespace iotcloud::drivers::depth
