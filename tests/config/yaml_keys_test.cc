// The recorded keys that a reader asks for.
#include <chrono>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/yaml.h>
#include <iotcloud/config/yaml/asked_keys.h>

namespace iotcloud::config {

bool operator==(const AskedKey& a, const AskedKey& b) {
  return as_json({a}) == as_json({b});
}

void PrintTo(const AskedKey& key, std::ostream* out) {
  *out << as_json({key});
}

namespace {

using testing::ElementsAre;
using testing::IsEmpty;

class AskedKeys : public testing::Test {
 protected:
  AskedKeys() { record_asked_keys(&keys_); }
  ~AskedKeys() override { record_asked_keys(nullptr); }
  AskedKeys(const AskedKeys&) = delete;
  AskedKeys& operator=(const AskedKeys&) = delete;

  std::vector<AskedKey> keys_;
};

TEST_F(AskedKeys, AreListedWhetherTheyAreThereOrNotWithWhatTheReaderSaysOfThem) {
  YamlSection top = YamlSection::parse("id: a\nport: 5", "x");
  top.require_string("id");
  top.int_or("port", 80, 1, 65535);
  top.bool_or("fast", true);
  top.duration_or("wait", std::chrono::milliseconds(1500));
  top.choice_or("mode", "one", {"one", "two"});
  EXPECT_THAT(keys_, ElementsAre(AskedKey{"id", "text", "", "", true},
                                 AskedKey{"port", "whole number", "80", "1 to 65535", false},
                                 AskedKey{"fast", "true or false", "true", "", false},
                                 AskedKey{"wait", "duration", "1500ms", "", false},
                                 AskedKey{"mode", "choice", "one", "\"one\", \"two\"", false}));
}

TEST_F(AskedKeys, InNamedSectionsAndSequencesStandOnceUnderAPlaceholder) {
  YamlSection top =
      YamlSection::parse("brokers: {a: {url: x}, b: {url: y}}\ninputs: [{from: a}, {from: b}]\nlog: {level: x}", "x");
  for (auto& [name, broker] : top.sections("brokers")) broker.string_or("url", "");
  for (YamlSection& input : top.section_list("inputs")) input.require_string("from");
  top.require_section("log").string_or("level", "info");
  EXPECT_THAT(keys_,
              ElementsAre(AskedKey{"brokers", "mapping of mappings", "", "", false},
                          AskedKey{"brokers.<name>.url", "text", "", "", false},
                          AskedKey{"inputs", "list of mappings", "", "", false},
                          AskedKey{"inputs[].from", "text", "", "", true}, AskedKey{"log", "mapping", "", "", true},
                          AskedKey{"log.level", "text", "info", "", false}));
}

TEST_F(AskedKeys, ThatAreAskedForAsTextFirstAreWhatTheyAreReadAs) {
  YamlSection top = YamlSection::parse("pending: 5", "x");
  if (top.optional_string("pending")) top.int_or("pending", 0, 0, 10);
  EXPECT_THAT(keys_, ElementsAre(AskedKey{"pending", "whole number", "0", "0 to 10", false}));
}

TEST_F(AskedKeys, AreNotRecordedAfterwards) {
  record_asked_keys(nullptr);
  YamlSection::parse("id: a", "x").require_string("id");
  EXPECT_THAT(keys_, IsEmpty());
}

TEST_F(AskedKeys, AreJsonForPrograms) {
  YamlSection::parse("id: a", "x").int_or("n", 1, 0, 2);
  const auto list = nlohmann::json::parse(as_json(keys_));
  ASSERT_EQ(list.size(), 1U);
  EXPECT_EQ(list[0]["key"], "n");
  EXPECT_EQ(list[0]["default"], "1");
  EXPECT_EQ(list[0]["required"], false);
}

}  // namespace
}  // namespace iotcloud::config
