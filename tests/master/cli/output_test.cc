#include <limits>
#include <sstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <yaml-cpp/yaml.h>

#include <iotcloud/master/cli/output.h>

namespace iotcloud::master::cli {
namespace {

using Json = nlohmann::ordered_json;

std::string yaml_of(const Json& value) {
  std::ostringstream out;
  print_yaml(out, value);
  return out.str();
}

/// What a YAML reader makes of `node`: quoted text is text, plain text is what YAML 1.1 takes it for.
Json read_back(const YAML::Node& node) {
  Json value;
  switch (node.Type()) {
    case YAML::NodeType::Map:
      value = Json::object();
      for (const auto& entry : node) value[entry.first.Scalar()] = read_back(entry.second);
      return value;
    case YAML::NodeType::Sequence:
      value = Json::array();
      for (const auto& item : node) value.push_back(read_back(item));
      return value;
    case YAML::NodeType::Scalar: {
      if (node.Tag() == "!") return node.Scalar();
      if (bool truth = false; YAML::convert<bool>::decode(node, truth)) return truth;
      if (std::int64_t number = 0; YAML::convert<std::int64_t>::decode(node, number)) return number;
      if (std::uint64_t number = 0; YAML::convert<std::uint64_t>::decode(node, number)) return number;
      if (double number = 0; YAML::convert<double>::decode(node, number)) return number;
      return node.Scalar();
    }
    default:
      return nullptr;
  }
}

TEST(PrintYaml, WhatItPrintsIsReadBackEqual) {
  const Json values = Json::array({
      "plain",
      "with-dash/and.dot_",
      "",
      " ",
      "two words",
      " before",
      "after ",
      "a: b",
      "a #b",
      "#b",
      "- item",
      "---",
      "...",
      "?",
      "[1]",
      "{a: b}",
      "*alias",
      "&name",
      "!tag",
      "@a",
      "`a`",
      "%a",
      "1",
      "-1",
      "1.5",
      "1e3",
      "0x1f",
      "0o17",
      "1_000",
      "12:30:45",
      ".inf",
      "-.inf",
      ".nan",
      "null",
      "Null",
      "~",
      "true",
      "False",
      "yes",
      "NO",
      "on",
      "Off",
      "y",
      "N",
      "2026-11-23",
      "=",
      "<<",
      "it's",
      "\"q\"",
      "a\\b",
      "two\nlines",
      "ends\n",
      "\ttab",
      "cr\r\nlf",
      "\x01\x1b[0m",
      "\x7f",
      "gr\u00fc\u00df",
      "\u6771\u4eac",
      "\U0001f916",
      "\u00a0",
      "\u0085\u2028\ufeff",
      std::string("nul\0in", 6),
      std::string(3000, 'x'),
  });
  EXPECT_EQ(read_back(YAML::Load(yaml_of(values))), values) << yaml_of(values);
  for (const auto& text : values) {
    EXPECT_EQ(read_back(YAML::Load(yaml_of(text))), text) << yaml_of(text);
    const Json keyed = {{text.get<std::string>(), {text}}};
    EXPECT_EQ(read_back(YAML::Load(yaml_of(keyed))), keyed) << yaml_of(keyed);
  }
}

TEST(PrintYaml, NumbersAndEmptyThingsAreReadBackEqual) {
  const Json value = {
      {"numbers",
       {0, -1, std::numeric_limits<std::int64_t>::min(), std::numeric_limits<std::uint64_t>::max(), 0.1, -2.5e-300,
        1e300}},
      {"truths", {true, false}},
      {"nothing", nullptr},
      {"no list", Json::array()},
      {"no map", Json::object()},
      {"nested", {{1, {2, Json::array()}}, {{"a", {{{"b", 1}}, {{"c", Json::object()}, {"d", 2}}}}}}},
  };
  EXPECT_EQ(read_back(YAML::Load(yaml_of(value))), value) << yaml_of(value);
}

TEST(PrintYaml, IsInBlockStyleWithQuotesWhereTheyAreNeeded) {
  EXPECT_EQ(yaml_of({{"gateway", "lab1"},
                     {"host", "127.0.0.1"},
                     {"port", 12905},
                     {"draining", false},
                     {"error", nullptr},
                     {"brokers", {"rabbitmq", "no"}},
                     {"drivers", {{{"id", "a/1"}, {"channels", Json::array()}}, {{"id", "a/2"}}}}}),
            "gateway: lab1\nhost: \"127.0.0.1\"\nport: 12905\ndraining: false\nerror: null\nbrokers:\n"
            "  - rabbitmq\n  - \"no\"\ndrivers:\n  - id: a/1\n    channels: []\n  - id: a/2\n");
  EXPECT_EQ(yaml_of(Json::array()), "[]\n");
  EXPECT_EQ(yaml_of("text"), "text\n");
}

TEST(PrintYaml, BytesThatAreNoUtf8DoNotSpoilTheDocument) {
  const auto read = YAML::Load(yaml_of({{"logged", "a\xff\xfe"}, {"next", "b"}}));
  EXPECT_THAT(read["logged"].Scalar(), ::testing::StartsWith("a\ufffd"));
  EXPECT_EQ(read["next"].Scalar(), "b");
}

}  // namespace
}  // namespace iotcloud::master::cli
