#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

/// The depth codec of the TurtleBot application (REFERENCE.md 6): 11-bit Kinect disparities become one byte a pixel
/// (the inversion step: a code that is linear in disparity and coarse in depth), then raw-block Snappy. Lossy by
/// design: the far end of the range has few codes.
namespace iotcloud::drivers::depth {

inline constexpr std::size_t frame_width = 640;
inline constexpr std::size_t frame_height = 480;
inline constexpr std::size_t frame_pixels = frame_width * frame_height;

/// The sensor's value for "no reading" in its 11-bit format; everything from 1023 up is none either.
inline constexpr std::uint16_t no_reading = 2047;
/// Disparities below and above are coded as 0 = no reading.
inline constexpr std::uint16_t first_coded_disparity = 61;
inline constexpr std::uint16_t last_coded_disparity = 1011;

/// Pinhole intrinsics of the sensor in pixels (REFERENCE.md 6: cx, cy, f).
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

/// Millimetres for a code, trunc(90300 / (code + 21.575)); 0 stays 0 = no reading. Thread safe.
const std::array<std::uint16_t, 256>& mm_table();

/// Compresses frames. Keeps its buffers: one object for each stream of frames. Not thread safe.
class DepthEncoder {
 public:
  DepthEncoder();
  /// \param disparities any 16-bit values: what is no disparity of the sensor counts as no reading.
  /// \return the compressed frame, valid until the next call or the destructor. Never fails. Nothing is allocated here
  /// (Snappy takes a hash table of some 200 KB for the call itself).
  std::span<const std::byte> encode(FrameView disparities);

 private:
  std::vector<std::uint8_t> codes_;
  std::vector<char> compressed_;
};

enum class DecodeError {
  none,
  not_snappy,  ///< not a raw Snappy block, or one that is cut off or damaged
  too_short,   ///< a Snappy block of fewer bytes than a frame has pixels
  too_long,    ///< a Snappy block that says it holds more
};

/// For logs: "not a raw Snappy block".
std::string_view describe(DecodeError error);

/// Decompresses frames from anywhere: nothing in the payload is trusted, no byte outside it is read, and no memory is
/// taken on its word. Keeps its buffers: one object for each task. Not thread safe.
class DepthDecoder {
 public:
  DepthDecoder();
  /// Fills `mm` (millimetres, 0 = no reading). With an error `mm` is left as it was. Never throws.
  [[nodiscard]] DecodeError decode(std::span<const std::byte> payload, FrameSpan mm) noexcept;

 private:
  std::vector<std::uint8_t> codes_;
};

}  // namespace iotcloud::drivers::depth
