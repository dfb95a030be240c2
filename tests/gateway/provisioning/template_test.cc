#include <string>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/provisioning/template.h>

namespace iotcloud::gateway {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

std::string filled(const std::string& text, const std::map<std::string, std::string>& attributes) {
  const auto filled = Template::parse(text).fill(attributes);
  return filled.text ? *filled.text : filled.missing.empty() ? filled.problem : "missing " + filled.missing;
}

TEST(Templates, have_places_for_attributes) {
  EXPECT_EQ(filled("mqtt://{address:host}:{port:number}", {{"address", "10.0.0.5"}, {"port", "1883"}}),
            "mqtt://10.0.0.5:1883");
  EXPECT_EQ(filled("{a}{a}-{{}}", {{"a", "x"}}), "xx-{}");
  EXPECT_EQ(filled("nothing", {}), "nothing");
  EXPECT_EQ(filled("{a}", {{"b", "x"}}), "missing a");
  EXPECT_FALSE(Template::parse("{{a}}").has_places());
}

TEST(Templates, that_are_wrong_are_refused) {
  const auto refusal = [](const std::string& text) -> std::string {
    try {
      Template::parse(text);
    } catch (const config::Error& e) {
      return e.what();
    }
    return "";
  };
  EXPECT_THAT(refusal("{a"), HasSubstr("without its \"}\""));
  EXPECT_THAT(refusal("a}"), HasSubstr("ends no place"));
  EXPECT_THAT(refusal("{}"), HasSubstr("no name"));
  EXPECT_THAT(refusal("{a:shell}"), HasSubstr("word, name, host, number, path, topic, topics, text"));
}

/// What a stranger announces must not mean more in a property than its place allows.
TEST(Templates, take_no_attribute_that_would_mean_something_else) {
  const auto is_refused = [](const std::string& form, const std::string& value) { return !in_form(form, value); };
  for (const std::string bad : {"", "a b", "a,b", "a=b", "a/b", "../a", ".a", "-a", "a\nb", "a\xff", "{a}", "a;b"})
    EXPECT_TRUE(is_refused("word", bad)) << bad;
  EXPECT_TRUE(is_refused("word", std::string("a\0b", 3)));
  EXPECT_TRUE(is_refused("word", std::string(201, 'a')));
  for (const std::string bad : {"", "a b", "host/path", "user@host", "host:80", "a..b", "::1]x", "[::1", "h\n"})
    EXPECT_TRUE(is_refused("host", bad)) << bad;
  for (const std::string bad : {"", "-", "1e5", "0x1", "1.2.3", "1.", ".5", " 1"})
    EXPECT_TRUE(is_refused("number", bad)) << bad;
  for (const std::string bad : {"/etc/passwd", "/dev/../etc/passwd", "/dev/", "dev/tty", "/dev/tty 1", "/dev/a,b"})
    EXPECT_TRUE(is_refused("path", bad)) << bad;
  for (const std::string bad :
       {"", "a/#", "+/a", "a,b", "a=b", "$SYS/a", " a", "a ", "a\tb", "a\xc0\x80", "a\xed\xa0\x80"})
    EXPECT_TRUE(is_refused("topic", bad)) << bad;
  for (const std::string bad : {"a", "a=b,", "a=b c", "#=b", "a=b,$SYS=c", "a=b=c"})
    EXPECT_TRUE(is_refused("topics", bad)) << bad;
  for (const std::string bad : {"a\nb", "a\x7f", "\xff", "\xe0\x80\x80", "\xf4\x90\x80\x80"})
    EXPECT_TRUE(is_refused("text", bad)) << bad;
  EXPECT_TRUE(is_refused("text", std::string(257, 'a')));
}

TEST(Templates, take_attributes_of_their_form) {
  EXPECT_EQ(in_form("host", "fe80::1"), "[fe80::1]");
  EXPECT_EQ(in_form("host", "[2001:db8::7]"), "[2001:db8::7]");
  EXPECT_EQ(in_form("host", "camera-1.local"), "camera-1.local");
  EXPECT_EQ(in_form("number", "-12.5"), "-12.5");
  EXPECT_EQ(in_form("path", "/dev/serial/by-id/usb-FTDI_FT232R-if00"), "/dev/serial/by-id/usb-FTDI_FT232R-if00");
  EXPECT_EQ(in_form("topic", "home/küche/temperature 1"), "home/küche/temperature 1");
  EXPECT_EQ(in_form("topics", "a/b=c,  d=e.1"), "a/b=c, d=e.1");
  EXPECT_EQ(in_form("text", "Größe \xf0\x9f\x98\x80"), "Größe \xf0\x9f\x98\x80");
  EXPECT_EQ(in_form("text", ""), "");
}

TEST(Templates, make_names_of_anything_and_keep_different_things_apart) {
  EXPECT_EQ(in_form("name", "meter-7"), "meter-7");
  EXPECT_THAT(*in_form("name", "a/b"), StartsWith("a-b-"));
  EXPECT_NE(in_form("name", "a/b"), in_form("name", "a b"));
  EXPECT_THAT(*in_form("name", "../x"), StartsWith("x.-x-"));
  EXPECT_LE(in_form("name", std::string(5000, '/'))->size(), 120U);
  EXPECT_FALSE(in_form("name", ""));
}

TEST(Templates, end_at_a_length) {
  std::string text;
  for (int i = 0; i < 40; ++i) text += "{a:text}";
  EXPECT_THAT(filled(text, {{"a", std::string(256, 'x')}}), HasSubstr("too long"));
}

}  // namespace
}  // namespace iotcloud::gateway
