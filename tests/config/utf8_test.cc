#include <string>

#include <gtest/gtest.h>

#include <iotcloud/config/utf8.h>

namespace iotcloud::config {
namespace {

TEST(Utf8, IsTakenWhereverItStands) {
  for (const char* text : {"", "a", "Grüße", "\xE2\x82\xAC", "\xF0\x9F\x98\x80", "\xED\x9F\xBF", "\xF4\x8F\xBF\xBF"}) {
    EXPECT_TRUE(is_utf8(text)) << text;
    EXPECT_TRUE(is_utf8("12345678" + std::string(text) + "123456789")) << text;
  }
}

TEST(Utf8, IsNotWhatIsOverlongASurrogateBeyondUnicodeOrCutOff) {
  for (const char* text :
       {"\x80", "\xFF", "\xC0\xAF", "\xC1\xBF", "\xE0\x9F\xBF", "\xF0\x8F\xBF\xBF", "\xED\xA0\x80", "\xF4\x90\x80\x80",
        "\xF5\x80\x80\x80", "\xC3", "\xE2\x82", "\xF0\x9F\x98", "\xC3(", "\xE2(\xAC"}) {
    EXPECT_FALSE(is_utf8(text));
    EXPECT_FALSE(is_utf8("12345678" + std::string(text)));
    EXPECT_FALSE(is_utf8(std::string(text) + "12345678"));
  }
}

}  // namespace
}  // namespace iotcloud::config
