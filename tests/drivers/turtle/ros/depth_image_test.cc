#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/turtle/disparities.h>
#include <iotcloud/drivers/turtle/ros/depth_image.h>

namespace iotcloud::drivers::turtle::ros {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr std::size_t pixels = depth::frame_pixels;

/// An image of one value, or of several that repeat along each row; `padding` bytes after each row.
template <typename Word>
struct Image {
  Image(const std::vector<Word>& values, std::string encoding, bool big_endian = false, std::size_t padding = 0)
      : name(std::move(encoding)) {
    const std::size_t step = 640 * sizeof(Word) + padding;
    bytes.assign(480 * step, 0xEE);
    for (std::size_t row = 0; row < 480; ++row) {
      for (std::size_t column = 0; column < 640; ++column) {
        auto word = std::bit_cast<std::array<std::uint8_t, sizeof(Word)>>(values[column % values.size()]);
        if (big_endian) std::reverse(word.begin(), word.end());  // tests run on little-endian machines
        std::memcpy(bytes.data() + row * step + column * sizeof(Word), word.data(), sizeof(Word));
      }
    }
    view = {640, 480, static_cast<std::uint32_t>(step), name, big_endian, bytes};
  }
  std::string name;
  std::vector<std::uint8_t> bytes;
  ImageView view;
};

std::vector<std::uint16_t> converted(const ImageView& image) {
  std::vector<std::uint16_t> disparities(pixels, 4711);
  EXPECT_EQ(convert_depth_image(image, depth::FrameSpan(disparities)), "");
  return disparities;
}

std::string refusal(const ImageView& image) {
  std::vector<std::uint16_t> disparities(pixels, 4711);
  std::string problem = convert_depth_image(image, depth::FrameSpan(disparities));
  EXPECT_EQ(disparities, std::vector<std::uint16_t>(pixels, 4711)) << "a refused image changed the frame";
  return problem;
}

TEST(RosDepthImage, the_error_is_half_a_step_of_the_sensor) {
  for (int mm = depth::disparity_to_mm(0); mm <= depth::disparity_to_mm(1022); ++mm) {
    const double tangent = mm / 123.6;
    const double step = 123.6 / 2842.5 * (1 + tangent * tangent);  // the derivative of disparity_to_mm()
    const int back = depth::disparity_to_mm(disparities_of_mm()[static_cast<std::size_t>(mm)]);
    EXPECT_LE(std::abs(back - mm), step / 2 * 1.05 + 1) << mm;
  }
  EXPECT_NEAR(depth::disparity_to_mm(disparities_of_mm()[700]), 700, 1);
  EXPECT_NEAR(depth::disparity_to_mm(disparities_of_mm()[4000]), 4000, 24);
}

TEST(RosDepthImage, takes_millimetres_and_metres_in_both_byte_orders_and_with_padded_rows) {
  const std::vector<std::uint16_t> mm{700, 1234, 0, 3999};
  const std::vector<float> metres{0.7f, 1.234f, 0.0f, 3.999f};
  std::vector<std::uint16_t> expected(pixels);
  for (std::size_t i = 0; i < pixels; ++i) expected[i] = disparities_of_mm()[mm[i % 640 % 4]];
  for (const bool big_endian : {false, true}) {
    for (const std::size_t padding : {0, 6}) {
      EXPECT_EQ(converted(Image<std::uint16_t>(mm, "16UC1", big_endian, padding).view), expected);
      EXPECT_EQ(converted(Image<float>(metres, "32FC1", big_endian, padding).view), expected);
    }
  }
}

TEST(RosDepthImage, metres_that_are_none_are_no_reading) {
  using Limits = std::numeric_limits<float>;
  const Image<float> image({Limits::quiet_NaN(), Limits::infinity(), -Limits::infinity(), -1.0f, 0.0f, 1e30f, 1e-30f},
                           "32FC1");
  EXPECT_EQ(converted(image.view), std::vector<std::uint16_t>(pixels, depth::no_reading));
}

TEST(RosDepthImage, says_what_is_wrong_with_an_image_and_what_would_be_right) {
  Image<std::uint16_t> image({1000}, "16UC1");
  const auto with = [&](auto change) {
    ImageView changed = image.view;
    change(changed);
    return refusal(changed);
  };
  EXPECT_THAT(with([](ImageView& view) { view.encoding = "rgb8"; }),
              AllOf(HasSubstr("rgb8"), HasSubstr("16UC1"), HasSubstr("32FC1")));
  EXPECT_THAT(with([](ImageView& view) { view.width = 320; }), AllOf(HasSubstr("320x480"), HasSubstr("640x480")));
  EXPECT_THAT(with([](ImageView& view) { view.height = 0; }), HasSubstr("640x480"));
  EXPECT_THAT(with([](ImageView& view) { view.step = 1279; }), AllOf(HasSubstr("1279"), HasSubstr("1280")));
  EXPECT_THAT(with([](ImageView& view) { view.step = 0xFFFFFFFF; }), HasSubstr("4294967295"));
  EXPECT_THAT(with([](ImageView& view) { view.bytes = view.bytes.first(view.bytes.size() - 1); }), HasSubstr("614399"));
  EXPECT_THAT(with([](ImageView& view) { view.encoding = "32FC1"; }), HasSubstr("2560"));
  EXPECT_THAT(with([](ImageView& view) { view.bytes = {}; }), HasSubstr("0 bytes in all"));
}

}  // namespace
}  // namespace iotcloud::drivers::turtle::ros
