// Hostile texts that must not keep a daemon busy: the reader refuses them before yaml-cpp builds anything.
#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/yaml.h>

namespace iotcloud::config {
namespace {

using std::string_literals::operator""s;
using testing::AllOf;
using testing::HasSubstr;
using testing::StartsWith;

std::string refusal_of(std::string_view text) {
  try {
    YamlSection::parse(text, "t.yaml");
  } catch (const ConfigError& e) {
    return e.what();
  }
  return "accepted";
}

std::string value_of(std::string_view text) {
  return YamlSection::parse(text, "t.yaml").require_string("a");
}

TEST(YamlText, reads_the_text_behind_a_byte_order_mark_with_places_as_an_editor_shows_them) {
  EXPECT_EQ(value_of("\xEF\xBB\xBF"
                     "a: b"),
            "b");
  const auto top = YamlSection::parse(
      "\xEF\xBB\xBF"
      "a: b%",
      "t.yaml");
  EXPECT_EQ(top.where("a").column, 1);
  EXPECT_EQ(top.error_within("a", 1, "").where().column, 5);
}

TEST(YamlText, says_that_only_utf8_is_read) {
  EXPECT_EQ(refusal_of("\xFF\xFE"
                       "a\0:\0 \0b\0"s),
            "t.yaml:1:1: this text is UTF-16, only UTF-8 is read; save it as UTF-8");
  EXPECT_THAT(refusal_of("\xFE\xFF\0a\0:"s), HasSubstr("UTF-16"));
}

TEST(YamlText, refuses_a_byte_that_is_no_utf8_with_its_place) {
  EXPECT_EQ(
      refusal_of("a: b\nc: \xE9t\xE9\n"),
      "t.yaml:2:4: the byte 0xe9, byte 9 of the text, is no valid UTF-8; save the text as UTF-8, or remove the byte");
}

TEST(YamlText, takes_utf8_as_the_standard_has_it_and_nothing_else) {
  for (const auto* good : {"\xC2\xA0", "\xDF\xBF", "\xE0\xA0\x80", "\xED\x9F\xBF", "\xEE\x80\x80", "\xEF\xBF\xBD",
                           "\xF0\x90\x80\x80", "\xF4\x8F\xBF\xBF"}) {
    EXPECT_EQ(value_of("a: \""s + good + "\""), good);
  }
  for (const auto* bad : {"\x80", "\xBF", "\xC0\x80", "\xC1\xBF", "\xC3", "\xE0\x9F\xBF", "\xE2\x82", "\xED\xA0\x80",
                          "\xF0\x8F\xBF\xBF", "\xF0\x90\x80", "\xF4\x90\x80\x80", "\xF8\x88\x80\x80\x80", "\xFF"}) {
    EXPECT_THAT(refusal_of("a: "s + bad), StartsWith("t.yaml:1:4: the byte 0x")) << testing::PrintToString(bad);
    EXPECT_THAT(refusal_of("a: \""s + bad + "\""), HasSubstr("no valid UTF-8")) << testing::PrintToString(bad);
  }
}

TEST(YamlText, refuses_control_characters_that_yaml_does_not_allow_with_their_place) {
  EXPECT_EQ(
      refusal_of("a: b\nc: d\x04"),
      "t.yaml:2:5: YAML does not allow the character U+0004, byte 10 of the text; remove it, or write \\u0004 within "
      "double quotes");
  EXPECT_THAT(refusal_of("a: \0b"s), HasSubstr("t.yaml:1:4: YAML does not allow the character U+0000"));
  EXPECT_THAT(refusal_of("a: \x7F"), HasSubstr("U+007F"));
  EXPECT_THAT(refusal_of("a: \xC2\x80"), HasSubstr("U+0080"));
  EXPECT_THAT(refusal_of("a: \xEF\xBF\xBE"), HasSubstr("U+FFFE"));
  EXPECT_EQ(value_of("a: \"\\u0004\""), "\x04");
  EXPECT_EQ(value_of("a: \"b\tc\"\r\n"), "b\tc");
}

TEST(YamlText, refuses_what_yaml_cpp_would_read_as_documents_without_end) {
  EXPECT_THAT(refusal_of(","), AllOf(StartsWith("t.yaml:1:1: "), HasSubstr("a comma or colon too many")));
  EXPECT_THAT(refusal_of("# fleet\n---\n, a: b\n"), StartsWith("t.yaml:3:1: what begins here does not belong to what"));
  EXPECT_THAT(refusal_of("- a\nb: 1\n"),
              StartsWith("t.yaml:2:1: what begins here does not belong to what stands before"));
}

TEST(YamlText, refuses_nesting_without_sense_where_it_becomes_too_deep) {
  EXPECT_THAT(refusal_of("a: " + std::string(100'000, '[')), HasSubstr("this is nested too deeply"));
  EXPECT_THAT(refusal_of("a: " + std::string(31, '[') + std::string(31, ']')), "accepted");
  std::string chain = "a0: &a0 [b]\n";
  for (int i = 1; i < 32; ++i) {
    const std::string n = std::to_string(i);
    chain += "a" + n + ": &a" + n + " [*a" + std::to_string(i - 1) + "]\n";
  }
  EXPECT_THAT(refusal_of(chain), StartsWith("t.yaml:32:12: this is nested too deeply; at most 32"));
}

TEST(YamlText, counts_what_aliases_stand_for_each_time) {
  std::string text = "a0: &a0 [x, x]\n";
  for (int i = 1; i < 30; ++i) {
    const std::string n = std::to_string(i);
    const std::string alias = "*a" + std::to_string(i - 1);
    text += "a" + n + ": &a" + n + " [" + alias + ", " + alias + "]\n";
    if (i == 10) {
      EXPECT_EQ(refusal_of(text), "accepted");
    }
  }
  EXPECT_THAT(refusal_of(text), HasSubstr("more than 500000 values"));
}

TEST(YamlText, bounds_the_length_of_a_text_and_of_a_file) {
  const std::string comment = "a: b\n#" + std::string(4 << 20, 'x');
  EXPECT_EQ(refusal_of(comment), "t.yaml: this text is longer than 4 MiB; split it");
  EXPECT_EQ(value_of(comment.substr(0, 4 << 20)), "b");
  try {
    YamlSection::load_file("/dev/zero");
    ADD_FAILURE() << "accepted";
  } catch (const ConfigError& e) {
    EXPECT_THAT(e.what(), HasSubstr("/dev/zero: this text is longer than 4 MiB"));
  }
}

TEST(YamlText, tells_an_empty_file_from_one_that_cannot_be_read) {
  const auto file = std::filesystem::path(testing::TempDir()) / "yaml_text_test_empty.yaml";
  std::ofstream(file).close();
  const auto refusal = [](const std::string& path) -> std::string {
    try {
      YamlSection::load_file(path);
    } catch (const ConfigError& e) {
      return e.what();
    }
    return "accepted";
  };
  EXPECT_THAT(refusal(file), HasSubstr("a mapping is expected at the top, not nothing"));
  std::filesystem::remove(file);
  EXPECT_THAT(refusal(file), HasSubstr("cannot be read"));
  EXPECT_THAT(refusal(testing::TempDir()), HasSubstr("cannot be read"));
}

}  // namespace
}  // namespace iotcloud::config
