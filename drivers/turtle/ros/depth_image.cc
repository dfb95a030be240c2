#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <vector>

#include <iotcloud/drivers/turtle/disparities.h>
#include <iotcloud/drivers/turtle/ros/depth_image.h>

namespace iotcloud::drivers::turtle::ros {

namespace {

/// Reads a number in the image's byte order.
template <typename Word>
Word load(const std::uint8_t* bytes, bool swap) {
  std::array<std::uint8_t, sizeof(Word)> word;
  std::memcpy(word.data(), bytes, sizeof(Word));
  if (swap) std::reverse(word.begin(), word.end());
  return std::bit_cast<Word>(word);
}

std::uint16_t from_metres(float metres, const std::vector<std::uint16_t>& disparities) {
  const float mm = metres * 1000 + 0.5f;
  // False for NaN too.
  const bool in_range = mm >= 1 && mm < static_cast<float>(disparities.size());
  return in_range ? disparities[static_cast<std::size_t>(mm)] : depth::no_reading;
}

template <typename Word, typename Convert>
void convert_rows(const ImageView& image, depth::FrameSpan disparities, Convert convert) {
  const bool swap = image.big_endian != (std::endian::native == std::endian::big);
  for (std::size_t row = 0; row < depth::frame_height; ++row) {
    const std::uint8_t* from = image.bytes.data() + row * image.step;
    std::uint16_t* to = disparities.data() + row * depth::frame_width;
    for (std::size_t column = 0; column < depth::frame_width; ++column) {
      to[column] = convert(load<Word>(from + column * sizeof(Word), swap));
    }
  }
}

std::string problem_of(const ImageView& image, std::size_t pixel_bytes) {
  if (pixel_bytes == 0) {
    return "its encoding is \"" + std::string(image.encoding.substr(0, 40)) +
           "\"; a depth image has 16UC1 (millimetres) or 32FC1 (metres)";
  }
  if (image.width != depth::frame_width || image.height != depth::frame_height) {
    return "it has " + std::to_string(image.width) + "x" + std::to_string(image.height) +
           " pixels; this driver takes 640x480: set the camera's mode, or the topic of another one";
  }
  const std::size_t row = depth::frame_width * pixel_bytes;
  const std::size_t needed = std::size_t{image.step} * (depth::frame_height - 1) + row;
  if (image.step < row || image.bytes.size() < needed) {
    return "it says that a row has " + std::to_string(image.step) + " bytes and has " +
           std::to_string(image.bytes.size()) + " bytes in all; " + std::string(image.encoding) +
           " needs rows of at least " + std::to_string(row) + " bytes, and 480 of them";
  }
  return {};
}

}  // namespace

std::string convert_depth_image(const ImageView& image, depth::FrameSpan disparities) {
  const bool millimetres = image.encoding == "16UC1";
  const bool metres = image.encoding == "32FC1";
  std::string problem = problem_of(image, millimetres ? sizeof(std::uint16_t) : metres ? sizeof(float) : 0);
  if (!problem.empty()) return problem;
  const std::vector<std::uint16_t>& known = disparities_of_mm();
  if (millimetres) {
    convert_rows<std::uint16_t>(image, disparities, [&](std::uint16_t mm) { return known[mm]; });
  } else {
    convert_rows<float>(image, disparities, [&](float value) { return from_metres(value, known); });
  }
  return problem;
}

}  // namespace iotcloud::drivers::turtle::ros
