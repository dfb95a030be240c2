#include <gtest/gtest.h>

#include <iotcloud/config/error.h>

namespace iotcloud::config {
namespace {

TEST(ConfigError, is_one_message_of_place_key_problem_and_remedy) {
  const ConfigError error({"a.yaml", 7, 3}, "spouts.in", "unknown key", "remove it");
  EXPECT_STREQ(error.what(), "a.yaml:7:3: spouts.in: unknown key; remove it");
  EXPECT_EQ(error.where().line, 7);
  EXPECT_EQ(error.key(), "spouts.in");
}

TEST(ConfigError, leaves_out_what_is_not_known) {
  EXPECT_STREQ(ConfigError({"a.yaml", 0, 0}, "", "cannot be read", "").what(), "a.yaml: cannot be read");
  EXPECT_STREQ(ConfigError({}, "level", "is none", "").what(), "level: is none");
}

}  // namespace
}  // namespace iotcloud::config
