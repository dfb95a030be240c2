// Both implementations of the inversion step and of its reverse give the same bytes.
#include <algorithm>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/depth/inversion.h>

namespace iotcloud::drivers::depth {
namespace {

class DepthInversion : public testing::TestWithParam<Path> {
 protected:
  void SetUp() override {
    if (!runs_here(GetParam())) GTEST_SKIP() << "this machine has no AVX2";
  }
};

TEST_P(DepthInversion, codes_every_16_bit_value_as_the_table_says) {
  std::vector<std::uint16_t> disparities(frame_pixels);
  // Every value at every position within the 32 that are processed at a time.
  for (std::size_t shift = 0; shift < 32; ++shift) {
    for (std::size_t i = 0; i < frame_pixels; ++i) disparities[i] = static_cast<std::uint16_t>(i + shift);
    std::vector<std::uint8_t> codes(frame_pixels, 77);
    to_codes(GetParam(), FrameView(disparities), codes.data());
    std::size_t wrong = 0;
    for (std::size_t i = 0; i < frame_pixels; ++i) {
      const std::uint16_t disparity = disparities[i];
      wrong += codes[i] != (disparity < 1024 ? code_table()[disparity] : 0);
    }
    ASSERT_EQ(wrong, 0U) << "shifted by " << shift;
  }
}

TEST_P(DepthInversion, gives_every_code_the_table_s_millimetres) {
  std::vector<std::uint8_t> codes(frame_pixels);
  std::mt19937 random(3);
  for (std::size_t i = 0; i < frame_pixels; ++i) codes[i] = static_cast<std::uint8_t>(i < 4096 ? i / 16 : random());
  std::vector<std::uint16_t> mm(frame_pixels, 12345), expected(frame_pixels);
  std::transform(codes.begin(), codes.end(), expected.begin(), [](std::uint8_t code) { return mm_table()[code]; });
  to_mm(GetParam(), codes.data(), FrameSpan(mm));
  EXPECT_TRUE(mm == expected);
}

INSTANTIATE_TEST_SUITE_P(Paths, DepthInversion, testing::Values(Path::portable, Path::avx2),
                         [](const auto& path) { return path.param == Path::avx2 ? "avx2" : "portable"; });

TEST(DepthInversionPath, is_the_fastest_unless_the_environment_wants_the_portable_one) {
  const char* portable = std::getenv("IOTCLOUD_PORTABLE");
  const bool wanted = portable && std::string(portable) == "1";
  EXPECT_EQ(best_path(), !wanted && runs_here(Path::avx2) ? Path::avx2 : Path::portable);
}

}  // namespace
}  // namespace iotcloud::drivers::depth
