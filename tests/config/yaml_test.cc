#include <algorithm>
#include <functional>
#include <stdexcept>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/yaml.h>

namespace iotcloud::config {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Pair;

YamlSection yaml(std::string_view text) {
  return YamlSection::parse(text, "test.yaml");
}

std::string message_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const ConfigError& e) {
    return e.what();
  }
  return "no error";
}

TEST(Yaml, reads_each_kind_of_value) {
  auto top = yaml(R"(
name: turtle
count: 3
ratio: 0.5
on: true
wait: 250ms
list: [a, b]
single: a
map: {x: 1, y: two}
)");
  EXPECT_EQ(top.require_string("name"), "turtle");
  EXPECT_EQ(top.require_int("count", 0, 10), 3);
  EXPECT_DOUBLE_EQ(top.double_or("ratio", 0, 0, 1), 0.5);
  EXPECT_TRUE(top.bool_or("on", false));
  EXPECT_EQ(top.duration_or("wait", 0us), 250ms);
  EXPECT_THAT(top.require_strings("list"), ElementsAre("a", "b"));
  EXPECT_THAT(top.require_strings("single"), ElementsAre("a"));
  EXPECT_THAT(top.string_map("map"), ElementsAre(Pair("x", "1"), Pair("y", "two")));
  EXPECT_NO_THROW(top.finish());
}

TEST(Yaml, falls_back_for_what_is_missing_or_empty) {
  auto top = yaml("name:\nother: x");
  EXPECT_EQ(top.string_or("name", "fallback"), "fallback");
  EXPECT_EQ(top.int_or("count", 7, 0, 10), 7);
  EXPECT_FALSE(top.has("name"));
  EXPECT_TRUE(top.has("other"));
}

TEST(Yaml, reports_an_unknown_key_with_place_and_the_nearest_known_one) {
  auto top = yaml("name: x\nspouts:\n  receive:\n    brokr: rabbitmq\n");
  static_cast<void>(top.require_string("name"));
  auto spout = top.sections("spouts").front().second;
  static_cast<void>(spout.optional_string("broker"));
  EXPECT_EQ(message_of([&] { spout.finish(); }),
            "test.yaml:4:5: spouts.receive.brokr: unknown key; did you mean \"broker\"?");
}

TEST(Yaml, lists_the_known_keys_when_none_is_near) {
  auto top = yaml("qqqqqq: 1");
  static_cast<void>(top.optional_string("name"));
  EXPECT_THAT(message_of([&] { top.finish(); }), HasSubstr("known are \"name\""));
}

TEST(Yaml, names_all_unknown_keys_of_a_section_at_once) {
  auto top = YamlSection::parse("name: a\nnam: b\nzone: c\n", "test.yaml");
  static_cast<void>(top.string_or("name", ""));
  EXPECT_EQ(message_of([&] { top.finish(); }),
            "test.yaml:2:1: nam: unknown key; did you mean \"name\"?\n"
            "test.yaml:3:1: zone: unknown key; known are \"name\"");
}

TEST(Yaml, names_a_tab_in_the_indentation_as_such) {
  EXPECT_EQ(
      message_of([] { YamlSection::parse("spouts:\n  in:\n\tbroker: a\n", "test.yaml"); }),
      "test.yaml:3:1: a TAB stands in the indentation here; YAML is indented by spaces only: set the editor to write "
      "spaces for the key TAB");
  EXPECT_THAT(message_of([] { YamlSection::parse("spouts:\n  in: a\n  \tbroker: a\n", "test.yaml"); }),
              HasSubstr("test.yaml:3:3: a TAB stands"));
  EXPECT_EQ(message_of([] { YamlSection::parse("a: b\tc\n", "test.yaml"); }), "no error");
}

TEST(Yaml, refuses_values_of_the_wrong_type_with_their_place) {
  auto top = yaml("count: many\nname: [a]\nlist: {a: 1}\nmap: text\nnested: {deep: {er: [1]}}");
  EXPECT_THAT(message_of([&] { top.int_or("count", 0, 0, 9); }),
              testing::AllOf(HasSubstr("test.yaml:1:1: count: \"many\""), HasSubstr("from 0 to 9")));
  EXPECT_THAT(message_of([&] { top.require_string("name"); }), HasSubstr("test.yaml:2:1: name: a single value"));
  EXPECT_THAT(message_of([&] { top.require_strings("list"); }),
              HasSubstr("a sequence is expected here, not a mapping"));
  EXPECT_THAT(message_of([&] { top.string_map("map"); }), HasSubstr("a mapping is expected here, not a single value"));
  EXPECT_THAT(message_of([&] { top.require_section("nested").string_map("deep"); }), HasSubstr("nested.deep.er"));
}

TEST(Yaml, refuses_numbers_out_of_range_and_with_rubbish_behind_them) {
  auto top = yaml("port: 70000\ncount: 12abc\nratio: 2\nnan: nan");
  EXPECT_THAT(message_of([&] { top.int_or("port", 1, 1, 65535); }), HasSubstr("from 1 to 65535"));
  EXPECT_THAT(message_of([&] { top.int_or("count", 1, 1, 65535); }), HasSubstr("12abc"));
  EXPECT_THAT(message_of([&] { top.double_or("ratio", 1, 0, 1); }), HasSubstr("from 0 to 1"));
  EXPECT_THAT(message_of([&] { top.double_or("nan", 1, 0, 1); }), HasSubstr("from 0 to 1"));
}

TEST(Yaml, refuses_a_duration_without_unit) {
  auto top = yaml("a: 5\nb: -5ms\nc: 1.5s\nd: 10us");
  EXPECT_THAT(message_of([&] { top.duration_or("a", 0us); }), HasSubstr("a number and a unit"));
  EXPECT_THAT(message_of([&] { top.duration_or("b", 0us); }), HasSubstr("not a duration"));
  EXPECT_EQ(top.duration_or("c", 0us), 1500ms);
  EXPECT_EQ(top.duration_or("d", 0us), 10us);
}

TEST(Yaml, suggests_the_choice_that_was_meant) {
  auto top = yaml("broker: rabitmq");
  EXPECT_THAT(message_of([&] {
                top.require_choice("broker", {"embedded", "rabbitmq"});
              }),
              testing::AllOf(HasSubstr("did you mean \"rabbitmq\"?"), HasSubstr("\"embedded\", \"rabbitmq\"")));
}

TEST(Yaml, names_a_key_that_is_missing) {
  auto top = yaml("a: {b: 1}");
  EXPECT_THAT(message_of([&] { top.require_section("a").require_string("c"); }),
              HasSubstr("a: the key \"c\" is missing"));
}

TEST(Yaml, tells_all_errors_of_a_text_in_its_order) {
  const std::string text = R"(count: many
count: 3
wait: 5
list: [[a], b, [c]]
inner: {port: 0, colour: red}
nested: {a: x}
)";
  const auto read = [](YamlSection& top) {
    EXPECT_EQ(top.int_or("count", 7, 0, 9), 7);
    EXPECT_EQ(top.duration_or("wait", 2s), 2s);
    EXPECT_THAT(top.require_strings("list"), ElementsAre("b"));
    auto inner = top.require_section("inner");
    EXPECT_EQ(inner.require_int("port", 1, 65535), 1);
    inner.refuse("port", "this is about a value that nobody wrote");
    inner.finish();
    top.part([&] { throw top.require_section("nested").error("a", "not this"); });
    auto missing = top.require_section("missing");
    EXPECT_EQ(missing.require_string("of_no_interest"), "");
  };
  EXPECT_EQ(message_of([&] { YamlSection::read_text(text, "t.yaml", read); }),
            "t.yaml:1:1: count: \"many\" does not fit; a whole number from 0 to 9 is expected\n"
            "t.yaml:1:1: the key \"missing\" is missing; add \"missing:\" and what belongs below it\n"
            "t.yaml:2:1: count: this key stands here twice; remove one of them\n"
            "t.yaml:3:1: wait: \"5\" is not a duration; write a number and a unit: 250ms, 2s, 5m, 1h or 10us\n"
            "t.yaml:4:8: list: single values are expected in this sequence, not a sequence\n"
            "t.yaml:4:16: list: single values are expected in this sequence, not a sequence\n"
            "t.yaml:5:9: inner.port: \"0\" does not fit; a whole number from 1 to 65535 is expected\n"
            "t.yaml:5:18: inner.colour: unknown key; known are \"port\"\n"
            "t.yaml:6:10: nested.a: not this");
}

TEST(Yaml, tells_what_a_reader_throws_unless_it_comes_from_a_stand_in) {
  const auto read = [](YamlSection& top) {
    top.require_string("name");
    throw std::runtime_error("the empty name");
  };
  EXPECT_THROW(YamlSection::read_text("name: x", "t.yaml", read), std::runtime_error);
  EXPECT_THAT(message_of([&] { YamlSection::read_text("other: x", "t.yaml", read); }),
              HasSubstr("\"name\" is missing"));
}

TEST(Yaml, tells_the_first_hundred_errors_of_a_text) {
  std::string text;
  for (int i = 0; i < 1000; ++i) text += "k" + std::to_string(i) + ": 1\n";
  const std::string told =
      message_of([&] { YamlSection::read_text(text, "t.yaml", [](YamlSection& top) { top.finish(); }); });
  EXPECT_EQ(std::count(told.begin(), told.end(), '\n'), 99);
}

TEST(Yaml, refuses_a_key_that_stands_twice_at_any_depth) {
  EXPECT_THAT(message_of([] { yaml("a: 1\na: 2"); }), HasSubstr("test.yaml:2:1: a: this key stands here twice"));
  EXPECT_THAT(message_of([] { yaml("a: [{b: 1, b: 2}]"); }), HasSubstr("a[0].b"));
}

TEST(Yaml, refuses_what_is_not_yaml_or_not_a_mapping) {
  EXPECT_THAT(message_of([] { yaml("a: [1"); }), HasSubstr("this is not YAML"));
  EXPECT_THAT(message_of([] { yaml("just text"); }), HasSubstr("a mapping is expected at the top"));
  EXPECT_THAT(message_of([] { yaml(""); }), HasSubstr("a mapping is expected at the top"));
  EXPECT_THAT(message_of([] { YamlSection::load_file("/nonexistent/x.yaml"); }), HasSubstr("cannot be read"));
}

TEST(Yaml, refuses_a_second_document_instead_of_ignoring_it) {
  EXPECT_THAT(message_of([] { yaml("a: 1\n---\nb: 2\n"); }), HasSubstr("test.yaml:2:1: a second document"));
  EXPECT_EQ(yaml("---\na: 1\n").require_string("a"), "1");
}

TEST(Yaml, refuses_an_alias_that_contains_itself) {
  EXPECT_THAT(message_of([] { yaml("a: &a [*a]"); }), HasSubstr("test.yaml:1:8: this alias contains itself"));
}

TEST(Yaml, keeps_sections_in_file_order_and_reads_a_single_mapping_as_a_list_of_one) {
  auto top = yaml("bolts: {z: {a: 1}, a: {a: 2}}\ninputs: {from: x}\nmore: [{from: y}, {from: z}]");
  const auto bolts = top.sections("bolts");
  ASSERT_EQ(bolts.size(), 2U);
  EXPECT_EQ(bolts[0].first, "z");
  EXPECT_EQ(bolts[0].second.path(), "bolts.z");
  EXPECT_EQ(top.section_list("inputs").size(), 1U);
  EXPECT_EQ(top.section_list("more").at(1).path(), "more[1]");
}

TEST(Yaml, reads_texts_and_mappings_of_one_sequence) {
  auto section = yaml("fields: [a, {property: b}]\nsingle: c\nempty: []\ndeep: [[d]]\n");
  auto items = section.require_items("fields");
  ASSERT_EQ(items.size(), 2U);
  EXPECT_EQ(items[0].text, "a");
  EXPECT_FALSE(items[0].mapping);
  ASSERT_TRUE(items[1].mapping);
  EXPECT_EQ(items[1].mapping->path(), "fields[1]");
  EXPECT_THAT(message_of([&] { items[1].mapping->finish(); }), HasSubstr("fields[1].property"));
  EXPECT_EQ(section.require_items("single").at(0).text, "c");
  EXPECT_THAT(message_of([&] { static_cast<void>(section.require_items("empty")); }), HasSubstr("must not be empty"));
  EXPECT_THAT(message_of([&] { static_cast<void>(section.require_items("deep")); }), HasSubstr("deep[0]"));
  EXPECT_THAT(message_of([&] { static_cast<void>(section.require_items("none")); }), HasSubstr("\"none\" is missing"));
}

TEST(Yaml, finds_a_key_of_a_mapping_below_by_its_path) {
  const auto section = YamlSection::parse("user: u\ntls:\n  ca: x\n  key: y\ntls.key: z\n", "t.yaml");
  EXPECT_EQ(section.where("tls.ca").line, 3);
  EXPECT_EQ(section.where("tls.key").line, 5) << "the key that is written so";
  for (const char* missing : {"tls.none", "user.none", "none.ca", ""}) EXPECT_EQ(section.where(missing).line, 1);
}

TEST(Yaml, finds_a_character_of_a_value_in_the_file_however_it_is_written) {
  const auto place = [](const std::string& text) {
    const auto section = YamlSection::parse(text, "t.yaml");
    const std::string value = YamlSection(section).require_string("where");
    const ConfigError error = section.error_within("where", value.find('%'), "here");
    return std::to_string(error.where().line) + ":" + std::to_string(error.where().column);
  };
  EXPECT_EQ(place("a: 1\nwhere: b == %\n"), "2:13");
  EXPECT_EQ(place("where: 'b == ''c'' %'\n"), "1:20");
  EXPECT_EQ(place(R"(where: "b == \"c\" %")"), "1:20");
  EXPECT_EQ(place("where: b\n  and %c\n"), "2:7");
  EXPECT_EQ(place("where: |\n  b\n  and %\n"), "3:7");
  EXPECT_EQ(place("where: >-\n\n  b   and\n  %\n"), "4:3");
  EXPECT_EQ(place("{ where: \"b and % c\" }"), "1:17");
  EXPECT_EQ(place("x: &e \"b %\"\nwhere: *e\n"), "1:10");
  EXPECT_EQ(place("where: \"b == \\u00e9 %\"\n"), "1:8");  // not told: the value's beginning
  EXPECT_EQ(place("where: b ==   \n"), "1:12");            // behind the end
}

TEST(Nearest, finds_typing_errors_and_nothing_far_away) {
  EXPECT_EQ(nearest("chanel", {"channel", "driver"}), "channel");
  EXPECT_EQ(nearest("xyz", {"channel", "driver"}), "");
}

}  // namespace
}  // namespace iotcloud::config
