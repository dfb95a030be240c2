#include <fstream>

#include <gmock/gmock.h>

#include <iotcloud/discovery/access.h>
#include <iotcloud/discovery/registry_setting.h>

namespace iotcloud::discovery::tests {
namespace {

using testing::AllOf;
using testing::HasSubstr;

RegistryOptions read(const std::string& text) {
  auto top = config::YamlSection::parse(text, "r.yaml");
  auto options = read_registry_options(top);
  top.finish();
  return options;
}

std::string error_of(const std::string& text) {
  try {
    read(text);
  } catch (const config::Error& error) {
    return error.what();
  }
  return "";
}

std::string file_with(const std::string& name, const std::string& text) {
  std::string path = testing::TempDir() + name;
  std::ofstream(path) << text;
  return path;
}

TEST(RegistrySetting, NothingIsNeeded) {
  const auto options = read("{}");
  EXPECT_EQ(options.session_timeout, std::chrono::seconds(10));
  EXPECT_TRUE(options.user.empty());
  EXPECT_FALSE(options.others_may_read);
  EXPECT_FALSE(options.open);
  EXPECT_TRUE(read("registry.open: true").open);
  EXPECT_FALSE(options.unencrypted);
}

TEST(RegistrySetting, ReadsUserAndTheFirstLineOfThePasswordFile) {
  const auto options = read(
      "registry.session_timeout: 4s\nregistry.user: fleet\nregistry.others_may_read: true\n"
      "registry.password_file: " +
      file_with("registry.password", "se:cret\r\nsecond line\n") + "\n");
  EXPECT_EQ(options.session_timeout, std::chrono::seconds(4));
  EXPECT_EQ(options.user, "fleet");
  EXPECT_EQ(options.password, "se:cret");
  EXPECT_TRUE(options.others_may_read);
}

TEST(RegistrySetting, ReadsThePasswordFromTheEnvironment) {
  ::setenv("IOTCLOUD_TEST_REGISTRY_PASSWORD", "from outside", 1);
  EXPECT_EQ(read("registry.user: fleet\nregistry.password_variable: IOTCLOUD_TEST_REGISTRY_PASSWORD").password,
            "from outside");
}

TEST(RegistrySetting, ReadsTheFleetsUsers) {
  ::setenv("IOTCLOUD_TEST_REGISTRY_PASSWORD", "p", 1);
  const std::string mine = "registry.user: g1\nregistry.password_variable: IOTCLOUD_TEST_REGISTRY_PASSWORD\n";
  const auto with = [&](const std::string& users) {
    return mine + "registry.users: " + file_with("registry.users", users) + "\n";
  };
  const std::string good = "# who there is\nmaster masters:d1=\n\ngateway g1:d2=\nworker w:d3=\n";
  const auto options = read(with(good));
  ASSERT_TRUE(options.access);
  const auto grants = options.access->grants("/iot/gateways/g1/orders/a", "masters");
  ASSERT_EQ(grants.size(), 2U);
  EXPECT_EQ(grants[0].id, "masters:d1=");
  EXPECT_EQ(grants[0].rights, RegistryAccess::all);
  EXPECT_EQ(grants[1].id, "g1:d2=");
  EXPECT_EQ(grants[1].rights, RegistryAccess::read);
  EXPECT_THAT(error_of(with("gateway g2:d\n")), AllOf(HasSubstr("registry.users"), HasSubstr("g1")));
  for (const char* line : {"gateway g1\n", "gateway g1:\n", "gateway :d\n", "guest g1:d\n", "gateway g1:d more\n"})
    EXPECT_THAT(error_of(with(line)), AllOf(HasSubstr(":1:"), HasSubstr("iotcloud registry user"))) << line;
  EXPECT_THAT(error_of(with(good + "worker g1:d\n")), HasSubstr("already"));
  EXPECT_THAT(error_of(mine + "registry.users: /nonexistent/users\n"), HasSubstr("/nonexistent/users"));
}

TEST(RegistrySetting, WhatCannotBeIsRefusedWithARemedy) {
  EXPECT_THAT(error_of("registry.user: fleet"), HasSubstr("registry.password_file"));
  EXPECT_THAT(error_of("registry.user: a:b\nregistry.password_variable: HOME"), HasSubstr("colon"));
  EXPECT_THAT(error_of("registry.user: u\nregistry.password_file: /nonexistent/p"), HasSubstr("/nonexistent/p"));
  EXPECT_THAT(error_of("registry.user: u\nregistry.password_file: " + file_with("empty.password", "\n")),
              HasSubstr("first line"));
  EXPECT_THAT(error_of("registry.user: u\nregistry.password_variable: IOTCLOUD_NO_SUCH_VARIABLE"),
              HasSubstr("IOTCLOUD_NO_SUCH_VARIABLE"));
  EXPECT_THAT(error_of("registry.password_file: /a\nregistry.password_variable: B"), HasSubstr("remove one"));
  EXPECT_THAT(error_of("registry.unencrypted: true"), HasSubstr("registry.user"));
  EXPECT_THAT(error_of("registry.others_may_read: true"), HasSubstr("registry.user"));
  EXPECT_THAT(error_of("registry.open: true\nregistry.user: u\nregistry.password_variable: HOME"),
              HasSubstr("registry.open"));
  EXPECT_THAT(error_of("registry.session_timeout: 1ms"), HasSubstr("10s is usual"));
}

}  // namespace
}  // namespace iotcloud::discovery::tests
