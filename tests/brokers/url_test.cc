#include <string>

#include <gtest/gtest.h>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/error.h>

namespace iotcloud::brokers {
namespace {

TEST(BrokerUrlTest, NamesAllItsParts) {
  const BrokerUrl url = parse_broker_url("amqp://guest:secret@robots.example:5673/lab");
  EXPECT_EQ(url.scheme, "amqp");
  EXPECT_EQ(url.user, "guest");
  EXPECT_EQ(url.password, "secret");
  EXPECT_EQ(url.host, "robots.example");
  EXPECT_EQ(url.port, 5673);
  EXPECT_EQ(url.path, "lab");
}

TEST(BrokerUrlTest, LeavesOutWhatIsNotGiven) {
  const BrokerUrl url = parse_broker_url("AMQP://localhost");
  EXPECT_EQ(url.scheme, "amqp");
  EXPECT_EQ(url.user, "");
  EXPECT_EQ(url.port, 0);
  EXPECT_FALSE(url.has_path);
  EXPECT_TRUE(parse_broker_url("amqp://localhost/").has_path);
}

TEST(BrokerUrlTest, HasTheUsualPortOfItsBrokerUnlessItNamesOne) {
  const auto port = [](const std::string& url) { return server_port(parse_broker_url(url)); };
  EXPECT_EQ(port("amqp://h:1"), 1);
  EXPECT_EQ(port("amqp://h"), 5672);
  EXPECT_EQ(port("amqps://h"), 5671);
  EXPECT_EQ(port("activemq://h"), 5672);
  EXPECT_EQ(port("activemqs://h"), 5671);
  EXPECT_EQ(port("kafka://h"), 9092);
  EXPECT_EQ(port("kafkas://h"), 9092);
}

TEST(BrokerUrlTest, DecodesPercentSigns) {
  const BrokerUrl url = parse_broker_url("amqp://u%40x:p%2Fw%3a@h/%2f");
  EXPECT_EQ(url.user, "u@x");
  EXPECT_EQ(url.password, "p/w:");
  EXPECT_EQ(url.path, "/");
}

TEST(BrokerUrlTest, TakesIpv6InBrackets) {
  const BrokerUrl url = parse_broker_url("amqp://[::1]:5672/");
  EXPECT_EQ(url.host, "::1");
  EXPECT_EQ(url.port, 5672);
}

TEST(BrokerUrlTest, RefusesWhatCannotBeReadAndNeverShowsThePassword) {
  for (const std::string bad : {"localhost", "amqp://", "amqp://u:secret@", "amqp://u:secret@h:0",
                                "amqp://u:secret@h:99999", "amqp://u:secret@h:5x/", "amqp://u:secret%zz@h",
                                "amqp://u:secret@[::1", "amqp://u:secret/x@h", "amqp://u:secret%4@h"}) {
    try {
      parse_broker_url(bad);
      ADD_FAILURE() << bad << " was taken";
    } catch (const config::Error& error) {
      EXPECT_EQ(std::string(error.what()).find("cret"), std::string::npos) << error.what();
    }
  }
}

TEST(PrintableUrlTest, HidesThePasswordOnly) {
  EXPECT_EQ(printable_url("amqp://guest:secret@host:5672/lab"), "amqp://guest:***@host:5672/lab");
  EXPECT_EQ(printable_url("amqp://guest@host"), "amqp://guest@host");
  EXPECT_EQ(printable_url("embedded://demo"), "embedded://demo");
  EXPECT_EQ(printable_url("amqp://u:a/b@c@host"), "amqp://u:***@host");
}

TEST(MakeBrokerTest, RefusesAnUnknownSchemeAndListsTheKnownOnes) {
  BrokerOptions options;
  options.urls = {"mqtt://u:secret@host"};
  try {
    make_broker(options);
    FAIL() << "no error";
  } catch (const config::Error& error) {
    const std::string text = error.what();
    EXPECT_NE(text.find("mqtt"), std::string::npos);
    EXPECT_NE(text.find("embedded"), std::string::npos);
    EXPECT_EQ(text.find("secret"), std::string::npos);
  }
}

}  // namespace
}  // namespace iotcloud::brokers
