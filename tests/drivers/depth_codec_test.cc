#include <algorithm>
#include <array>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <openssl/sha.h>
#include <snappy.h>

#include <iotcloud/drivers/depth/depth_codec.h>

namespace iotcloud::drivers::depth {
namespace {

std::string hexadecimal(std::span<const unsigned char> bytes) {
  static constexpr char digits[] = "0123456789abcdef";
  std::string text;
  for (const unsigned char byte : bytes) {
    text += digits[byte >> 4];
    text += digits[byte & 15];
  }
  return text;
}

std::span<const std::byte> as_payload(const std::string& text) {
  return std::as_bytes(std::span(text));
}

std::string snappy_block(std::size_t size, char fill = 7) {
  std::string block;
  const std::string raw(size, fill);
  snappy::Compress(raw.data(), raw.size(), &block);
  return block;
}

/// Decodes into a frame of sentinels. \return the error, and whether all sentinels stayed.
std::pair<DecodeError, bool> decode_into_sentinels(std::span<const std::byte> payload) {
  std::vector<std::uint16_t> mm(frame_pixels, 12345);
  DepthDecoder decoder;
  const DecodeError error = decoder.decode(payload, FrameSpan(mm));
  return {error, std::all_of(mm.begin(), mm.end(), [](std::uint16_t v) { return v == 12345; })};
}

struct Golden {
  int disparity, code, mm;
};

// docs/wire.md#depth-frames
constexpr Golden golden_values[] = {{61, 255, 326},  {100, 244, 340}, {200, 215, 381}, {300, 187, 432},
                                    {400, 160, 497}, {500, 132, 587}, {600, 106, 707}, {700, 79, 897},
                                    {800, 53, 1210}, {900, 27, 1858}, {1000, 1, 4000}};

TEST(DepthCodec, codes_the_golden_disparities_as_the_original_does) {
  for (const Golden& golden : golden_values) {
    EXPECT_EQ(code_table()[golden.disparity], golden.code) << "disparity " << golden.disparity;
    EXPECT_EQ(mm_table()[golden.code], golden.mm) << "code " << golden.code;
  }
  for (int disparity = 1004; disparity <= 1011; ++disparity) EXPECT_EQ(code_table()[disparity], 0);
  EXPECT_EQ(mm_table()[0], 0);
}

TEST(DepthCodec, has_the_original_s_table_to_the_last_byte) {
  std::array<unsigned char, SHA256_DIGEST_LENGTH> digest{};
  SHA256(code_table().data(), code_table().size(), digest.data());
  EXPECT_EQ(hexadecimal(digest), "73464bc28c1167dbe3c2c2bf762551ad5f33dd575ed4698095ad77997730814e");
}

TEST(DepthCodec, carries_every_16_bit_value_through_a_frame) {
  std::vector<std::uint16_t> disparities(frame_pixels);
  for (std::size_t i = 0; i < frame_pixels; ++i) disparities[i] = static_cast<std::uint16_t>(i % 65536);
  DepthEncoder encoder;
  DepthDecoder decoder;
  std::vector<std::uint16_t> mm(frame_pixels);
  ASSERT_EQ(decoder.decode(encoder.encode(FrameView(disparities)), FrameSpan(mm)), DecodeError::none);
  for (std::size_t i = 0; i < frame_pixels; ++i) {
    const std::uint16_t disparity = disparities[i];
    const int expected = disparity < 1024 ? mm_table()[code_table()[disparity]] : 0;
    ASSERT_EQ(mm[i], expected) << "disparity " << disparity << " at pixel " << i;
  }
}

TEST(DepthCodec, never_makes_depth_shorter_and_longer_by_less_than_a_code_and_a_half) {
  for (int disparity = first_coded_disparity; disparity <= 1000; ++disparity) {
    const int code = code_table()[disparity];
    // Both truncations of the code together take up to 1.425 off the inverse depth.
    EXPECT_LE(disparity_to_mm(disparity), mm_table()[code] + 1) << "disparity " << disparity;
    EXPECT_GE(disparity_to_mm(disparity), 90300 / (code + 21.575 + 1.425) - 1) << "disparity " << disparity;
  }
}

TEST(DepthCodec, gives_the_same_result_when_its_buffers_are_used_again) {
  std::vector<std::uint16_t> first(frame_pixels, 500);
  std::vector<std::uint16_t> second(frame_pixels);
  std::mt19937 random(1);
  for (auto& value : second) value = static_cast<std::uint16_t>(random() % 2048);
  DepthEncoder reused;
  reused.encode(FrameView(second));
  const auto again = reused.encode(FrameView(first));
  DepthEncoder fresh;
  const auto once = fresh.encode(FrameView(first));
  EXPECT_TRUE(std::equal(again.begin(), again.end(), once.begin(), once.end()));
}

TEST(DepthCodec, is_a_raw_snappy_block_of_one_byte_a_pixel) {
  const std::vector<std::uint16_t> disparities(frame_pixels, 600);
  DepthEncoder encoder;
  const auto payload = encoder.encode(FrameView(disparities));
  std::string codes;
  ASSERT_TRUE(snappy::Uncompress(reinterpret_cast<const char*>(payload.data()), payload.size(), &codes));
  EXPECT_EQ(codes, std::string(frame_pixels, static_cast<char>(106)));
}

TEST(DepthDecoder, refuses_what_is_not_snappy) {
  const std::string text = "GET / HTTP/1.1\r\n\r\n";
  for (const std::string& payload : {std::string(), std::string(1, '\x80'), std::string(64, '\xff'), text}) {
    const auto [error, untouched] = decode_into_sentinels(as_payload(payload));
    EXPECT_NE(error, DecodeError::none);
    EXPECT_TRUE(untouched);
  }
  EXPECT_EQ(decode_into_sentinels({}).first, DecodeError::not_snappy);
  EXPECT_EQ(decode_into_sentinels(as_payload(std::string(64, '\xff'))).first, DecodeError::not_snappy);
}

TEST(DepthDecoder, refuses_a_block_of_another_size_than_a_frame) {
  EXPECT_EQ(decode_into_sentinels(as_payload(snappy_block(0))).first, DecodeError::too_short);
  EXPECT_EQ(decode_into_sentinels(as_payload(snappy_block(frame_pixels - 1))).first, DecodeError::too_short);
  EXPECT_EQ(decode_into_sentinels(as_payload(snappy_block(frame_pixels))).first, DecodeError::none);
  EXPECT_EQ(decode_into_sentinels(as_payload(snappy_block(frame_pixels + 1))).first, DecodeError::too_long);
}

TEST(DepthDecoder, takes_no_memory_on_the_word_of_a_payload) {
  const std::string four_gigabytes = "\xff\xff\xff\xff\x0f";  // the declared length, and nothing behind it
  EXPECT_EQ(decode_into_sentinels(as_payload(four_gigabytes)).first, DecodeError::too_long);
}

TEST(DepthDecoder, refuses_every_block_that_is_cut_off_or_goes_on) {
  std::vector<std::uint16_t> disparities(frame_pixels);
  for (std::size_t i = 0; i < frame_pixels; ++i) disparities[i] = static_cast<std::uint16_t>(400 + (i * i / 977) % 300);
  DepthEncoder encoder;
  const auto payload = encoder.encode(FrameView(disparities));
  const std::size_t stride = payload.size() / 40;
  for (std::size_t size = 0; size < payload.size(); size += stride) {
    // A copy of exact size, so that the address sanitizer sees a read behind its end.
    const std::vector<std::byte> cut(payload.begin(), payload.begin() + static_cast<std::ptrdiff_t>(size));
    const auto [error, untouched] = decode_into_sentinels(cut);
    EXPECT_EQ(error, DecodeError::not_snappy) << size << " of " << payload.size() << " bytes";
    EXPECT_TRUE(untouched);
  }
  std::vector<std::byte> longer(payload.begin(), payload.end());
  longer.push_back(std::byte{0});
  longer.push_back(std::byte{65});
  EXPECT_EQ(decode_into_sentinels(longer).first, DecodeError::not_snappy);
}

TEST(DepthDecoder, survives_random_damage) {
  std::vector<std::uint16_t> disparities(frame_pixels);
  std::mt19937 random(7);
  for (std::size_t i = 0; i < frame_pixels; ++i) disparities[i] = static_cast<std::uint16_t>(600 + random() % 4);
  DepthEncoder encoder;
  const auto payload = encoder.encode(FrameView(disparities));
  const std::vector<std::byte> good(payload.begin(), payload.end());
  DepthDecoder decoder;
  std::vector<std::uint16_t> mm(frame_pixels);
  int refused = 0;
  for (int round = 0; round < 200; ++round) {
    std::vector<std::byte> bad = good;
    for (int flips = 0; flips < 8; ++flips) bad[random() % bad.size()] = static_cast<std::byte>(random() % 256);
    if (decoder.decode(bad, FrameSpan(mm)) != DecodeError::none) ++refused;
  }
  EXPECT_GT(refused, 0);
  EXPECT_EQ(decoder.decode(good, FrameSpan(mm)), DecodeError::none);  // the decoder still works
}

}  // namespace
}  // namespace iotcloud::drivers::depth
