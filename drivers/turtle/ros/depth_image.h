#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include <iotcloud/drivers/depth/depth_codec.h>

namespace iotcloud::drivers::turtle::ros {

/// A sensor_msgs/Image without ROS types. Refers to the message's bytes.
struct ImageView {
  std::uint32_t width = 0, height = 0;  ///< pixels
  std::uint32_t step = 0;               ///< bytes from the start of one row to the next
  std::string_view encoding;
  bool big_endian = false;
  std::span<const std::uint8_t> bytes;
};

/// Converts a depth image to the disparities that the codec takes (disparities.h: the nearest one; the error is half a
/// step of a Kinect, 0.7 mm at 0.7 m, 1.5 mm at 1 m and 23 mm at 4 m, and 1 mm of rounding). Encodings are those of
/// ROS: 16UC1 (millimetres) and 32FC1 (metres); 0, NaN, infinite and negative values mean "no reading". Trusts nothing
/// in the image. Thread safe.
/// \return empty, or what is wrong with the image and what would be right; `disparities` then keeps its values.
std::string convert_depth_image(const ImageView& image, depth::FrameSpan disparities);

}  // namespace iotcloud::drivers::turtle::ros
