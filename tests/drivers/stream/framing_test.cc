#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/stream/framing.h>

namespace iotcloud::drivers::stream {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::span<const std::byte> bytes_of(const std::string& text) {
  return std::as_bytes(std::span(text));
}

/// The frames in a stream that comes in pieces of this size.
std::vector<std::string> frames_in(FrameDecoder& decoder, const std::string& stream, std::size_t piece = 1'000'000) {
  std::vector<std::string> frames;
  for (std::size_t at = 0; at < stream.size(); at += piece) {
    decoder.feed(bytes_of(stream).subspan(at, std::min(piece, stream.size() - at)));
    while (const auto frame = decoder.next()) frames.emplace_back(frame->text());
  }
  return frames;
}

std::vector<FramingOptions> all_framings() {
  FramingOptions lines, windows, small, large, cobs, slip;
  lines.most_bytes = windows.most_bytes = small.most_bytes = large.most_bytes = cobs.most_bytes = slip.most_bytes =
      2000;
  windows.delimiter = "\r\n";
  small.kind = large.kind = Framing::length;
  large.length_bytes = 4;
  large.little_endian = large.length_counts_itself = true;
  cobs.kind = Framing::cobs;
  slip.kind = Framing::slip;
  return {lines, windows, small, large, cobs, slip};
}

TEST(Framing, GivesBackWhatWasFramedInPiecesOfAnySize) {
  std::vector<std::string> frames{"a", "", std::string(253, 'x'), std::string(254, 'x'), std::string(255, 'x'), "\r"};
  std::string odd;
  for (int i = 0; i < 600; ++i) odd += static_cast<char>(i * 7 % 256);
  for (const FramingOptions& options : all_framings()) {
    std::vector<std::string> sent = frames;
    if (options.kind != Framing::delimiter) sent.insert(sent.end(), {odd, std::string(3, '\0'), "\xc0\xdb\xdc\xdd"});
    if (options.kind == Framing::slip) std::erase(sent, "");  // an empty one means nothing there
    std::string stream;
    for (const std::string& frame : sent) stream += framed(options, bytes_of(frame));
    for (const std::size_t piece : {1U, 2U, 3U, 7U, 255U, 100'000U}) {
      FrameDecoder decoder(options);
      EXPECT_EQ(frames_in(decoder, stream, piece), sent) << static_cast<int>(options.kind) << ' ' << piece;
      EXPECT_EQ(decoder.refused(), 0U);
      EXPECT_FALSE(decoder.unfinished());
    }
  }
}

TEST(Framing, LeavesOutAFrameThatIsTooLongAndTakesTheNext) {
  for (FramingOptions options : all_framings()) {
    if (options.kind == Framing::length) continue;
    const std::string stream = framed(options, bytes_of("one")) + framed(options, bytes_of(std::string(900, 'x'))) +
                               framed(options, bytes_of("two"));
    options.most_bytes = 10;
    for (const std::size_t piece : {1U, 5U, 100'000U}) {
      FrameDecoder decoder(options);
      EXPECT_THAT(frames_in(decoder, stream, piece), ElementsAre("one", "two"));
      EXPECT_EQ(decoder.refused(), 1U);
    }
  }
}

TEST(Framing, EndsAStreamWhoseLengthNoFrameMayHave) {
  FramingOptions options;
  options.kind = Framing::length;
  options.most_bytes = 100;
  FrameDecoder decoder(options);
  EXPECT_THAT(frames_in(decoder, std::string("\0\2ok\0\x64", 6)), ElementsAre("ok"));
  FrameDecoder other(options);
  EXPECT_THROW(frames_in(other, std::string("\0\2ok\0\x65", 6)), FramingError);
  EXPECT_FALSE(other.unfinished());
  options.length_counts_itself = true;
  FrameDecoder short_one(options);
  EXPECT_THROW(frames_in(short_one, std::string("\0\1", 2)), FramingError);
}

TEST(Framing, LeavesOutWhatIsNoCobsAndNoSlip) {
  FramingOptions cobs, slip;
  cobs.kind = Framing::cobs;
  slip.kind = Framing::slip;
  FrameDecoder of_cobs(cobs), of_slip(slip);
  EXPECT_THAT(frames_in(of_cobs, std::string("\5ab\0\2a\0", 7)), ElementsAre("a"));
  EXPECT_THAT(frames_in(of_slip,
                        "ab\xdb\xc0"
                        "a\xdb"
                        "b\xc0"
                        "c\xc0"),
              ElementsAre("c"));
  EXPECT_EQ(of_cobs.refused(), 1U);
  EXPECT_EQ(of_slip.refused(), 2U);
}

TEST(Framing, TakesWhatComesAtOnceForAFrameWhenThereIsNone) {
  FramingOptions options;
  options.kind = Framing::none;
  options.most_bytes = 4;
  FrameDecoder decoder(options);
  EXPECT_THAT(frames_in(decoder, "abcdef"), ElementsAre("abcd", "ef"));
}

TEST(Framing, ForgetsTheBeginningOfAFrame) {
  FrameDecoder decoder({});
  EXPECT_THAT(frames_in(decoder, "noi"), ElementsAre());
  EXPECT_TRUE(decoder.unfinished());
  decoder.reset();
  EXPECT_THAT(frames_in(decoder, "line\n"), ElementsAre("line"));
}

TEST(Framing, SendsNoFrameThatTheDeviceWouldTakeForAnother) {
  FramingOptions options;
  options.most_bytes = 10;
  EXPECT_THROW(framed(options, bytes_of("two\nlines")), FramingError);
  EXPECT_THROW(framed(options, bytes_of("longer than ten")), FramingError);
  options.delimiter = "--";
  EXPECT_THROW(framed(options, bytes_of("a-")), FramingError);  // with the delimiter it is "a---"
  options.kind = Framing::length;
  options.length_bytes = 1;
  options.most_bytes = 1000;
  EXPECT_THROW(framed(options, bytes_of(std::string(256, 'x'))), FramingError);
}

TEST(Framing, ReadsItsPropertiesAndSaysWhichIsWrong) {
  const PropertyMap good{
      {"framing", "length"}, {"length_bytes", "4"}, {"length_order", "little"}, {"delimiter", "\\r\\x1f\\\\\\0"}};
  PropertyReader reader(good);
  const FramingOptions options = read_framing(reader);
  EXPECT_EQ(options.kind, Framing::length);
  EXPECT_EQ(options.length_bytes, 4U);
  EXPECT_TRUE(options.little_endian);
  EXPECT_EQ(options.delimiter, std::string("\r\x1f\\\0", 4));
  for (const char* wrong : {"", "\\q", "\\x1", "\\xzz", "12345678901234567", "\\"}) {
    const PropertyMap properties{{"delimiter", wrong}};
    PropertyReader of_wrong(properties);
    try {
      read_framing(of_wrong);
      ADD_FAILURE() << wrong;
    } catch (const std::invalid_argument& e) {
      EXPECT_THAT(e.what(), HasSubstr("property \"delimiter\"")) << wrong;
    }
  }
}

}  // namespace
}  // namespace iotcloud::drivers::stream
