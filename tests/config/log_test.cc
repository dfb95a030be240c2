#include <algorithm>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/log_settings.h>

namespace iotcloud::config {
namespace {

using testing::HasSubstr;
using testing::Not;

class Log : public testing::Test {
 protected:
  ~Log() override {
    set_log_level(before_);
    set_log_format(LogFormat::text);
  }

 private:
  const LogLevel before_ = log_level();
};

TEST_F(Log, writes_one_line_with_level_part_and_text_to_stderr) {
  set_log_level(LogLevel::info);
  testing::internal::CaptureStderr();
  Logger{"brokers.rabbitmq"}.warn("connected to {} after {} tries", "amqp://host", 3);
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              testing::ContainsRegex(" warn.* brokers.rabbitmq: connected to amqp://host after 3 tries\n$"));
}

TEST_F(Log, leaves_out_what_is_below_the_level) {
  set_log_level(LogLevel::warn);
  testing::internal::CaptureStderr();
  const Logger log{"part"};
  log.debug("one");
  log.info("two");
  log.error("three");
  const std::string written = testing::internal::GetCapturedStderr();
  EXPECT_THAT(written, Not(HasSubstr("one")));
  EXPECT_THAT(written, Not(HasSubstr("two")));
  EXPECT_THAT(written, HasSubstr("three"));
}

TEST_F(Log, takes_braces_in_a_text_as_they_are) {
  testing::internal::CaptureStderr();
  log_line(LogLevel::error, "part", "{} {0} {broken");
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("part: {} {0} {broken"));
}

TEST_F(Log, writes_an_object_on_each_line_as_json_whatever_bytes_are_in_it) {
  set_log_level(LogLevel::info);
  set_log_format(LogFormat::json);
  testing::internal::CaptureStderr();
  Logger{"part"}.warn("a \"quote\", a \\, {} and a line\nbreak, \xff", "{}");
  const std::string written = testing::internal::GetCapturedStderr();
  ASSERT_EQ(std::count(written.begin(), written.end(), '\n'), 1) << written;
  const auto line = nlohmann::json::parse(written);
  EXPECT_EQ(line.at("part"), "part");
  EXPECT_EQ(line.at("level"), "warning");
  EXPECT_EQ(line.at("text"), "a \"quote\", a \\, {} and a line\nbreak, \xef\xbf\xbd");
  EXPECT_THAT(line.at("time").get<std::string>(), testing::MatchesRegex("....-..-..T..:..:..\\....[+-]..:.."));
}

TEST_F(Log, is_set_by_the_section_log_of_a_file) {
  auto top = YamlSection::parse("log: {level: error, format: json}", "a.yaml");
  const LogSettings settings = read_log_settings(top);
  EXPECT_NO_THROW(top.finish());
  apply(settings);
  EXPECT_EQ(log_level(), LogLevel::error);
  EXPECT_THAT(log_options(), testing::ElementsAre("--log-level", "error", "--log-format", "json"));
  apply({});
  EXPECT_EQ(log_level(), LogLevel::error) << "what is not said stays";
  auto wrong = YamlSection::parse("log:\n  level: loud", "a.yaml");
  try {
    read_log_settings(wrong);
    FAIL();
  } catch (const ConfigError& error) {
    EXPECT_THAT(error.what(), HasSubstr("a.yaml:2:"));
    EXPECT_THAT(error.what(), HasSubstr("log.level"));
  }
}

TEST_F(Log, knows_its_levels_by_name_and_no_others) {
  for (const auto* name : {"debug", "info", "warn", "error", "off"}) {
    set_log_level(parse_log_level(name));
    EXPECT_EQ(log_level(), parse_log_level(name)) << name;
  }
  EXPECT_THROW(parse_log_level("loud"), ConfigError);
}

}  // namespace
}  // namespace iotcloud::config
