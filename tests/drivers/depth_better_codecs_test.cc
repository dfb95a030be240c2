// The codecs whose payloads are tagged: compact (the reference's codes) and lossless.
#include <algorithm>
#include <array>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <zlib.h>

#include <iotcloud/drivers/depth/depth_codec.h>

namespace iotcloud::drivers::depth {
namespace {

using Frame = std::vector<std::uint16_t>;
using Bytes = std::vector<std::byte>;

/// A slope with steps, noise of `noise` disparities, and gaps; `seed` moves all of it.
Frame scene(std::uint32_t seed, int noise) {
  std::mt19937 random(seed);
  Frame frame(frame_pixels);
  const int left = static_cast<int>(random() % 300), top = static_cast<int>(random() % 200);
  for (int v = 0; v < static_cast<int>(frame_height); ++v) {
    for (int u = 0; u < static_cast<int>(frame_width); ++u) {
      const bool nearer = u > left && u < left + 200 && v > top && v < top + 220;
      const int plain = nearer ? 620 + u / 9 : 900 - v / 3;
      const bool gap = random() % 100 == 0 || (nearer && u < left + 12) || u >= 632;
      const int moved = plain + static_cast<int>(random() % (2 * noise + 1)) - noise;
      frame[v * frame_width + u] = gap ? no_reading : static_cast<std::uint16_t>(moved);
    }
  }
  return frame;
}

Frame noise(std::uint32_t seed, int values) {
  std::mt19937 random(seed);
  Frame frame(frame_pixels);
  for (auto& value : frame) value = static_cast<std::uint16_t>(random() % values);
  return frame;
}

Bytes encoded(Codec codec, const Frame& frame) {
  DepthEncoder encoder(codec);
  const auto payload = encoder.encode(FrameView(frame));
  return {payload.begin(), payload.end()};
}

/// What a receiver gets: millimetres, and for a lossless frame its disparities.
struct Decoded {
  DecodeError error = DecodeError::none;
  Frame mm, disparities;
};

/// What is in the frames before. Made once, and copied and compared as a whole: a loop over pixels takes sanitized
/// tests longer than what they test.
const Frame unwritten_mm(frame_pixels, 12345), unwritten_disparities(frame_pixels, 54321);

Decoded decoded(DepthDecoder& decoder, const Bytes& payload) {
  Decoded result{.mm = unwritten_mm, .disparities = unwritten_disparities};
  result.error = decoder.decode(payload, FrameSpan(result.mm));
  const DecodeError of_disparities = decoder.decode_disparities(payload, FrameSpan(result.disparities));
  if (of_disparities != DecodeError::not_lossless) {
    EXPECT_EQ(of_disparities, result.error);
  }
  return result;
}

bool untouched(const Decoded& result) {
  return result.mm == unwritten_mm && result.disparities == unwritten_disparities;
}

void expect_carried(Codec codec, const Frame& frame, const Decoded& result) {
  ASSERT_EQ(result.error, DecodeError::none) << describe(result.error);
  std::size_t wrong = 0;
  for (std::size_t i = 0; i < frame_pixels; ++i) {
    const std::uint16_t disparity = std::min(frame[i], no_reading);
    if (codec == Codec::lossless) {
      wrong += result.disparities[i] != disparity || result.mm[i] != disparity_mm_table()[disparity];
    } else {
      wrong += result.mm[i] != (disparity < 1024 ? mm_table()[code_table()[disparity]] : 0);
    }
  }
  EXPECT_EQ(wrong, 0U);
}

/// Sets the right checksum after a change, so that the decoder itself must notice the error.
void sign(Bytes& payload) {
  const auto* bytes = reinterpret_cast<const Bytef*>(payload.data());
  const auto of_codec = crc32(0, bytes + 3, 1);
  const auto sum = crc32(of_codec, bytes + 8, static_cast<uInt>(payload.size() - 8));
  for (int i = 0; i < 4; ++i) payload[4 + i] = static_cast<std::byte>(sum >> (8 * i) & 0xff);
}

class BetterCodec : public testing::TestWithParam<Codec> {};

TEST_P(BetterCodec, carries_every_frame_exactly) {
  DepthEncoder encoder(GetParam());
  DepthDecoder decoder;
  Frame every(frame_pixels), stripes(frame_pixels);
  for (std::size_t i = 0; i < frame_pixels; ++i) {
    every[i] = static_cast<std::uint16_t>(i % 65536);
    stripes[i] = i % 2 == 0 ? 61 : no_reading;
  }
  const std::vector<Frame> frames = {scene(1, 0),
                                     scene(2, 1),
                                     scene(3, 20),
                                     every,
                                     stripes,
                                     Frame(frame_pixels, no_reading),
                                     Frame(frame_pixels, 0),
                                     Frame(frame_pixels, 600),
                                     noise(1, 2048),
                                     noise(2, 1100),
                                     noise(3, 2)};
  for (std::size_t i = 0; i < frames.size(); ++i) {
    SCOPED_TRACE(i);
    const auto payload = encoder.encode(FrameView(frames[i]));
    expect_carried(GetParam(), frames[i], decoded(decoder, {payload.begin(), payload.end()}));
  }
}

TEST_P(BetterCodec, makes_the_same_payload_whatever_it_encoded_before) {
  DepthEncoder used(GetParam());
  used.encode(FrameView(noise(5, 2048)));
  const Frame frame = scene(7, 1);
  const auto again = used.encode(FrameView(frame));
  EXPECT_TRUE(std::equal(again.begin(), again.end(), encoded(GetParam(), frame).begin()));
  EXPECT_EQ(again.size(), encoded(GetParam(), frame).size());
}

TEST_P(BetterCodec, decodes_each_frame_without_any_other) {
  std::vector<Frame> frames;
  DepthEncoder encoder(GetParam());
  std::vector<Bytes> payloads;
  for (std::uint32_t seed = 1; seed <= 4; ++seed) {
    frames.push_back(scene(seed, 2));
    const auto payload = encoder.encode(FrameView(frames.back()));
    payloads.emplace_back(payload.begin(), payload.end());
  }
  payloads[1][payloads[1].size() / 2] ^= std::byte{1};
  DepthDecoder decoder;
  for (const std::size_t i : {3U, 1U, 0U, 2U, 1U, 3U}) {
    SCOPED_TRACE(i);
    const Decoded result = decoded(decoder, payloads[i]);
    if (i == 1) {
      EXPECT_EQ(result.error, DecodeError::damaged);
    } else {
      expect_carried(GetParam(), frames[i], result);
    }
  }
}

TEST_P(BetterCodec, refuses_a_payload_with_any_byte_changed) {
  const Bytes good = encoded(GetParam(), scene(4, 1));
  DepthDecoder decoder;
  for (std::size_t at = 3; at < good.size(); at += at < 64 ? 1 : good.size() / 50) {
    Bytes bad = good;
    bad[at] ^= std::byte{0x10};
    const Decoded result = decoded(decoder, bad);
    ASSERT_EQ(result.error, DecodeError::damaged) << "byte " << at;
    ASSERT_TRUE(untouched(result));
  }
}

TEST_P(BetterCodec, refuses_a_payload_that_is_cut_off_or_goes_on) {
  const Bytes good = encoded(GetParam(), scene(4, 1));
  DepthDecoder decoder;
  for (std::size_t size = 3; size < good.size(); size += size < 32 ? 1 : good.size() / 40) {
    // A copy of exact size, so that the address sanitizer sees a read behind its end.
    Bytes cut(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(size));
    ASSERT_EQ(decoded(decoder, cut).error, DecodeError::damaged) << size << " bytes";
    if (size < 8) continue;
    sign(cut);
    const Decoded result = decoded(decoder, cut);
    ASSERT_EQ(result.error, DecodeError::malformed) << size << " bytes, with the right checksum";
    ASSERT_TRUE(untouched(result));
  }
  Bytes longer = good;
  longer.insert(longer.end(), 2, std::byte{0});
  EXPECT_EQ(decoded(decoder, longer).error, DecodeError::damaged);
  sign(longer);
  EXPECT_EQ(decoded(decoder, longer).error, DecodeError::malformed);
}

TEST_P(BetterCodec, survives_what_no_encoder_wrote) {
  const Bytes good = encoded(GetParam(), scene(4, 1));
  DepthDecoder decoder;
  std::mt19937 random(9);
  int refused = 0;
  constexpr int rounds = 60;
  for (int round = 0; round < rounds; ++round) {
    Bytes bad = good;
    // The tables are in the first two thousand bytes.
    const std::size_t range = round % 2 == 0 ? 2000 : bad.size() - 8;
    for (int flips = 0; flips < 4; ++flips) bad[8 + random() % range] = static_cast<std::byte>(random() % 256);
    sign(bad);
    const DecodeError error = decoded(decoder, bad).error;
    EXPECT_TRUE(error == DecodeError::malformed || error == DecodeError::none) << describe(error);
    refused += error == DecodeError::malformed;
  }
  EXPECT_GT(refused, rounds * 9 / 10);
  Bytes huge = good;
  huge.resize(4'000'000, std::byte{0x5a});  // more than any frame needs
  sign(huge);
  EXPECT_EQ(decoded(decoder, huge).error, DecodeError::malformed);
  EXPECT_EQ(decoded(decoder, good).error, DecodeError::none);  // the decoder still works
}

INSTANTIATE_TEST_SUITE_P(Codecs, BetterCodec, testing::Values(Codec::compact, Codec::lossless),
                         [](const auto& codec) { return std::string(codec_names[static_cast<int>(codec.param)]); });

TEST(DepthCodecs, are_told_apart_by_the_payload) {
  const Frame frame = scene(1, 1);
  DepthDecoder decoder;
  for (const Codec codec : {Codec::lossless, Codec::reference, Codec::compact, Codec::reference}) {
    expect_carried(codec, frame, decoded(decoder, encoded(codec, frame)));
  }
  EXPECT_EQ(decoded(decoder, encoded(Codec::compact, frame)).mm, decoded(decoder, encoded(Codec::reference, frame)).mm);
}

TEST(DepthCodecs, have_a_tag_that_begins_no_payload_of_the_reference) {
  // A raw Snappy block begins with its length in groups of seven bits, the lowest first: 307200 is 80 E0 12, or 80 E0
  // 92 00 and so on.
  const Bytes reference = encoded(Codec::reference, scene(1, 1));
  EXPECT_EQ(reference[0], std::byte{0x80});
  for (const Codec codec : {Codec::compact, Codec::lossless}) {
    const Bytes payload = encoded(codec, scene(1, 1));
    EXPECT_EQ(std::string(reinterpret_cast<const char*>(payload.data()), 3), "IDC");
    EXPECT_EQ(payload[3], static_cast<std::byte>(codec));
  }
}

TEST(DepthCodecs, refuse_a_codec_that_is_not_known) {
  DepthDecoder decoder;
  for (const int codec : {0, 3, 255}) {
    Bytes payload = encoded(Codec::compact, scene(1, 1));
    payload[3] = static_cast<std::byte>(codec);
    sign(payload);
    const Decoded result = decoded(decoder, payload);
    EXPECT_EQ(result.error, DecodeError::unknown_codec);
    EXPECT_TRUE(untouched(result));
  }
}

TEST(DepthCodecs, have_disparities_in_lossless_frames_only) {
  DepthDecoder decoder;
  Frame disparities(frame_pixels, 7);
  for (const Codec codec : {Codec::reference, Codec::compact}) {
    EXPECT_EQ(decoder.decode_disparities(encoded(codec, scene(1, 1)), FrameSpan(disparities)),
              DecodeError::not_lossless);
  }
  EXPECT_EQ(decoder.decode_disparities({}, FrameSpan(disparities)), DecodeError::not_lossless);
  EXPECT_EQ(disparities, Frame(frame_pixels, 7));
}

TEST(DepthCodecs, have_names) {
  EXPECT_EQ(codec_named("reference"), Codec::reference);
  EXPECT_EQ(codec_named("compact"), Codec::compact);
  EXPECT_EQ(codec_named("lossless"), Codec::lossless);
  EXPECT_EQ(codec_named("zip"), std::nullopt);
}

TEST(DepthCodecs, make_less_of_a_scene_than_the_reference) {
  const Frame frame = scene(1, 1);
  EXPECT_LT(encoded(Codec::compact, frame).size() * 2, encoded(Codec::reference, frame).size());
}

}  // namespace
}  // namespace iotcloud::drivers::depth
