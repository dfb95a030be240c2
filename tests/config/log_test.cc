#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>

namespace iotcloud::config {
namespace {

using testing::HasSubstr;
using testing::Not;

class Log : public testing::Test {
 protected:
  ~Log() override { set_log_level(before_); }

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

TEST_F(Log, knows_its_levels_by_name_and_no_others) {
  for (const auto* name : {"debug", "info", "warn", "error", "off"}) {
    set_log_level(parse_log_level(name));
    EXPECT_EQ(log_level(), parse_log_level(name)) << name;
  }
  EXPECT_THROW(parse_log_level("loud"), ConfigError);
}

}  // namespace
}  // namespace iotcloud::config
