#include <cstdlib>
#include <filesystem>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/credentials.h"
#include <iotcloud/brokers/broker_pool.h>
#include <iotcloud/brokers/broker_setting.h>

namespace iotcloud::brokers {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using namespace std::chrono_literals;

BrokerOptions read(const std::string& text) {
  auto section = config::YamlSection::parse(text, "broker.yaml");
  BrokerOptions options = read_broker_options(section, 10s);
  section.finish();
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

/// A file with the given content, removed at the end.
class File {
 public:
  explicit File(const std::string& content)
      : path_(std::filesystem::path(testing::TempDir()) / ("secret" + std::to_string(::getpid()))) {
    std::ofstream(path_) << content;
  }
  File(const File&) = delete;
  ~File() { std::filesystem::remove(path_); }
  std::string path() const { return path_.string(); }

 private:
  std::filesystem::path path_;
};

TEST(BrokerSetting, ReadsWhatConnectingTakes) {
  const File file("x");
  const auto options = read("urls: [\"amqps://a/\", \"amqps://b/\"]\nuser: robot\npassword_file: " + file.path() +
                            "\ntls: {ca: " + file.path() + ", revoked: " + file.path() +
                            "}\nheartbeat: 2s\nproperties: {queue_type: quorum}\n");
  EXPECT_EQ(options.urls.size(), 2U);
  EXPECT_EQ(options.user, "robot");
  EXPECT_EQ(options.password_file, file.path());
  EXPECT_EQ(options.tls.ca_file, file.path());
  EXPECT_EQ(options.tls.revoked_file, file.path());
  EXPECT_EQ(options.heartbeat, 2s);
  EXPECT_EQ(options.properties.at("queue_type"), "quorum");
}

TEST(BrokerSetting, TheHeartbeatIsAtMostHalfOfTheRegistrysSessionTimeout) {
  EXPECT_EQ(read("urls: []").heartbeat, 4s);
  EXPECT_THAT(error_of("heartbeat: 6s"), HasSubstr("5000 ms"));
  auto section = config::YamlSection::parse("{}", "broker.yaml");
  EXPECT_EQ(read_broker_options(section, 2s).heartbeat, 1s);
}

TEST(BrokerSetting, SaysWhatIsWrongAndWhere) {
  EXPECT_THAT(error_of("urls: [\"mqtt://a\"]"), HasSubstr("broker.yaml:1"));
  EXPECT_THAT(error_of("urls: [\"mqtt://a\"]"), HasSubstr("mqtt"));
  EXPECT_THAT(error_of("password_file: /none/such"), HasSubstr("/none/such"));
  EXPECT_THAT(error_of("user: u\ntls:\n  ca: /none/such"),
              AllOf(HasSubstr("broker.yaml:3"), HasSubstr("tls.ca"), HasSubstr("/none/such")));
  EXPECT_THAT(error_of("tls: {revoked: /none/such}"), AllOf(HasSubstr("tls.revoked"), HasSubstr("/none/such")));
  EXPECT_THAT(error_of("user: u\nproperties:\n  reader: r\n  reader_password_file: /none/such"),
              AllOf(HasSubstr("broker.yaml:4"), HasSubstr("reader_password_file"), HasSubstr("/none/such")));
  const File file("x");
  EXPECT_THAT(error_of("tls: {certificate: " + file.path() + "}"), HasSubstr("key"));
  EXPECT_THAT(error_of("password_variable: P\npassword_file: " + file.path()), HasSubstr("remove one"));
}

TEST(BrokerSetting, NamesTheFilesThatItsClientReads) {
  EXPECT_TRUE(files_of(read("user: u")).empty());
  const File file("x");
  const auto options = read("password_file: " + file.path() + "\ntls: {ca: " + file.path() +
                            "}\nproperties: {reader: r, reader_password_file: " + file.path() + "}\n");
  const std::map<std::string, std::string> expected = {
      {"password_file", file.path()}, {"tls.ca", file.path()}, {"properties.reader_password_file", file.path()}};
  EXPECT_EQ(files_of(options), expected);
}

TEST(Credentials, GoFromTheFileOrTheEnvironmentBeforeTheUrl) {
  const BrokerUrl url = parse_broker_url("amqp://guest:hidden@host/");
  BrokerOptions options;
  EXPECT_EQ(credentials_for(options, url).password, "hidden");
  const File file("from file\r\nsecond line\n");
  options.user = "robot";
  options.password_file = file.path();
  EXPECT_EQ(credentials_for(options, url).user, "robot");
  EXPECT_EQ(credentials_for(options, url).password, "from file");
  options.password_file.clear();
  options.password_variable = "IOTCLOUD_TEST_PASSWORD";
  ::setenv("IOTCLOUD_TEST_PASSWORD", "from environment", 1);
  EXPECT_EQ(credentials_for(options, url).password, "from environment");
  ::unsetenv("IOTCLOUD_TEST_PASSWORD");
  EXPECT_THROW(credentials_for(options, url), config::Error);
  options.password_variable.clear();
  options.password_file = "/none/such";
  EXPECT_THROW(credentials_for(options, url), config::Error);
}

TEST(BrokerPool, SharesOneBrokerForAnAddressAsLongAsItIsUsed) {
  BrokerPool pool(nullptr, nullptr);
  const BrokerAddress address{"local", {"embedded://pool"}};
  auto one = pool.get(address, {});
  EXPECT_EQ(pool.get(address, {}), one);
  EXPECT_NE(pool.get({"other", address.urls}, {}), one);
  ASSERT_EQ(pool.in_use().size(), 1U) << "the other one is gone";
  EXPECT_EQ(pool.in_use().front().first, address);
  const std::weak_ptr<Broker> watched = one;
  one.reset();
  EXPECT_TRUE(watched.expired());
}

TEST(BrokerAddress, BeginsWithTheServerThatIsPreferredAndTakesNothingElseFromItsUrl) {
  using Urls = std::vector<std::string>;
  const auto preferring = [](const std::string& url) {
    BrokerAddress address{"b", {"amqps://u:p@one:5671/", "amqps://two:5671/", "amqps://three/"}};
    address.prefer(url);
    return address.urls;
  };
  EXPECT_EQ(preferring("amqp://two:5671/"), (Urls{"amqps://two:5671/", "amqps://three/", "amqps://u:p@one:5671/"}));
  EXPECT_EQ(preferring("amqp://three:5672/").front(), "amqps://three/");
  for (const std::string other : {"amqp://thief:5671/", "amqp://two:1/", "nonsense", ""})
    EXPECT_EQ(preferring(other).front(), "amqps://u:p@one:5671/");
}

TEST(MakeBroker, RefusesAReaderOfRabbitMqWithoutAPasswordAndAPasswordWithoutAReader) {
  BrokerOptions options;
  options.urls = {"amqp://host/"};
  for (const char* alone : {"reader", "reader_password_file"}) {
    options.properties = {{alone, "x"}};
    try {
      static_cast<void>(make_broker(options));
      FAIL() << alone;
    } catch (const config::Error& error) {
      EXPECT_THAT(error.what(), HasSubstr("go together"));
    }
  }
}

TEST(MakeBroker, RefusesServersOfSeveralKinds) {
  BrokerOptions options;
  EXPECT_THROW(static_cast<void>(make_broker(options)), config::Error);
  options.urls = {"amqp://a:secret@host/", "embedded://b"};
  try {
    static_cast<void>(make_broker(options));
    FAIL();
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("amqp://a:***@host/"));
  }
}

}  // namespace
}  // namespace iotcloud::brokers
