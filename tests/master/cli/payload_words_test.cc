#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/master/cli/channels/payload_words.h>

namespace iotcloud::master::cli {
namespace {

using namespace std::string_literals;

std::string shown(const std::string& payload, PayloadFormat format = PayloadFormat::auto_) {
  return payload_words(payload, static_cast<std::int64_t>(payload.size()), format);
}

TEST(PayloadWords, FindTheFormatThatAPersonReads) {
  EXPECT_EQ(shown("21.5"), "21.5");
  EXPECT_EQ(shown("grün"), "grün");
  EXPECT_EQ(shown(R"({ "t": 21.5,  "on": true })"), R"({"t":21.5,"on":true})");
  EXPECT_EQ(shown("\x01\xFF\x80"s), "<3 B: 01 ff 80>");
  EXPECT_EQ(shown(""), "");
  EXPECT_EQ(payload_words("abc", 10, PayloadFormat::auto_), "abc... (10 B)");
  EXPECT_EQ(payload_words("{\"a", 10, PayloadFormat::auto_), "{\"a... (10 B)");
  EXPECT_EQ(payload_words(std::string(64, '\0'), 64, PayloadFormat::auto_).substr(0, 14), "<64 B: 00 00 0");
}

TEST(PayloadWords, KeepToTheFormatThatIsAskedFor) {
  EXPECT_EQ(shown("on", PayloadFormat::hex), "<2 B: 6f 6e>");
  EXPECT_EQ(shown("7", PayloadFormat::json), "7");
  EXPECT_EQ(shown("no json", PayloadFormat::json), "no json");
  EXPECT_EQ(shown("[1]", PayloadFormat::text), "[1]");
  EXPECT_EQ(shown("a\nb", PayloadFormat::text), "a b") << "one line";
  EXPECT_EQ(shown("on", PayloadFormat::image), "<2 B: 6f 6e>");
}

TEST(PayloadWords, ShowJsonOfTooManyLevelsAsText) {
  const auto nested = [](int levels, const std::string& open, const std::string& close) {
    std::string text;
    for (int i = 0; i < levels; ++i) text += open;
    text += "1";
    for (int i = 0; i < levels; ++i) text += close;
    return text;
  };
  for (const auto format : {PayloadFormat::auto_, PayloadFormat::json}) {
    for (const int levels : {65, 131'071}) {  // 256 KiB of lists: the most that `channel echo` asks for
      for (const auto& text : {nested(levels, "[", "]"), nested(levels, R"({"a":)", "}")}) {
        EXPECT_TRUE(shown(text, format) == text) << levels;
        const auto json = payload_json(text, static_cast<std::int64_t>(text.size()), format);
        EXPECT_EQ(json["format"], "text") << levels;
        EXPECT_TRUE(json["payload"] == text) << levels;
      }
    }
    const std::string text = nested(64, "[", "]");
    EXPECT_EQ(shown(text, format), text);
    EXPECT_EQ(payload_json(text, static_cast<std::int64_t>(text.size()), format)["format"], "json");
  }
}

TEST(PayloadWords, TellTheSizeOfAnImage) {
  const auto png = "\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x02\x80\0\0\x01\xe0\x08\x02\0\0\0"s;
  EXPECT_EQ(shown(png), "<PNG image 640x480, 29 B>");
  const auto jpeg = "\xff\xd8\xff\xe0\0\x04\0\0\xff\xc0\0\x11\x08\0\xf0\x01\x40\x03"s;
  EXPECT_EQ(shown(jpeg), "<JPEG image 320x240, 18 B>");
  EXPECT_EQ(shown("GIF89a\x10\0\x20\0\0"s), "<GIF image 16x32, 11 B>");
  EXPECT_EQ(shown("P5 640 480 255\n..."), "<PNM image 640x480, 18 B>");
  EXPECT_EQ(shown("\x80\xe0\x12\0"s), "<depth image 640x480, 4 B>");
  EXPECT_EQ(payload_json(png, 29, PayloadFormat::auto_)["payload"]["width"], 640);
  EXPECT_FALSE(image_size("\xff\xd8\xff\xe0\0\0"s)) << "a cut JPEG has no size";
  EXPECT_FALSE(image_size("P5 x"));
}

TEST(PayloadWords, TellTextFromBytes) {
  EXPECT_TRUE(is_text("a\tb\r\n"));
  EXPECT_FALSE(is_text("\x1b[2J"));
  EXPECT_FALSE(is_text("\xc3"));
  EXPECT_TRUE(is_text("a\xc3", true)) << "its last character may be cut off";
  EXPECT_FALSE(is_text("\xc3(", true));
  EXPECT_FALSE(is_text("\xc0\xaf"));
}

TEST(PayloadWords, WriteBytesWithUnits) {
  EXPECT_EQ(byte_words(0), "0 B");
  EXPECT_EQ(byte_words(999), "999 B");
  EXPECT_EQ(byte_words(1500), "1.5 kB");
  EXPECT_EQ(byte_words(2.5e6), "2.5 MB");
}

}  // namespace
}  // namespace iotcloud::master::cli
