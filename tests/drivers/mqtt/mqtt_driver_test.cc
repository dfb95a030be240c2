// The driver against a real Mosquitto. The device is a bare client of libmosquitto.
#include <chrono>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/mqtt/mqtt_driver.h>
#include <iotcloud/tests/drivers/mqtt/connected.h>
#include <iotcloud/tests/drivers/mqtt/device.h>
#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/servers/private_server.h>

namespace iotcloud::drivers::mqtt {
namespace {

using namespace std::chrono_literals;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::MockInstance;

Descriptor mqtt_plugin() {
  return describe<MqttDriver>("mqtt", "test", true);
}

/// A device at the shared broker.
class Device : public mqtt::Device {
 public:
  explicit Device(const std::string& filter = {}) : mqtt::Device(shared_broker().url(), filter) {}
};

/// Waits until the broker has the subscriptions: a retained message comes by one of them.
void until_subscribed(MockInstance& instance, Device& device, const std::string& channel, const std::string& to) {
  device.publish(to, "retained", true);
  EXPECT_TRUE(until_published(instance, channel, 1));
  instance.host().forget_published();
}

/// Of the protocol, and of the quality of service both ways.
class MqttVersions : public ::testing::TestWithParam<std::tuple<const char*, int>> {};

TEST_P(MqttVersions, make_channels_of_topics_and_publish_commands) {
  const auto& [version, qos] = GetParam();
  const std::string base = "versions" + std::string(version) + std::to_string(qos);
  Device device(base + "/commands/#");
  const auto hub = connected<MqttDriver>({{"version", version},
                                          {"qos", std::to_string(qos)},
                                          {"publish_qos", std::to_string(qos)},
                                          {"publish_topic", base + "/commands/all"},
                                          {"subscribe", base + "/+/temperature=temperature, " + base + "/state"}});
  until_subscribed(*hub, device, "messages", base + "/state");
  device.publish(base + "/kitchen/temperature", "21.5", false, "C");
  device.publish(base + "/state", "on");
  device.publish(base + "/other", "not asked for");
  device.publish(base + "/hall/temperature", "18");
  ASSERT_TRUE(until_published(*hub, "temperature", 2));
  ASSERT_TRUE(until_published(*hub, "messages", 1));
  EXPECT_THAT(texts(*hub, "temperature"), ElementsAre("21.5", "18"));
  EXPECT_THAT(texts(*hub, "messages"), ElementsAre("on"));
  const auto first = hub->host().published("temperature")[0].message;
  EXPECT_EQ(*first.properties.find("topic"), base + "/kitchen/temperature");
  const bool five = std::string(version) == "5";
  ASSERT_EQ(first.properties.find("unit") != nullptr, five);
  EXPECT_TRUE(!five || *first.properties.find("unit") == "C");
  Message heat = command("heat");
  heat.properties.set("topic", base + "/commands/kitchen");
  heat.properties.set("who", "topology");
  ASSERT_TRUE(hub->deliver("publish", heat));
  ASSERT_TRUE(hub->deliver("publish", command("stop")));
  ASSERT_TRUE(until(*hub, [&] { return device.received().size() == 2; }));
  EXPECT_THAT(device.received(),
              ElementsAre(base + "/commands/kitchen heat" + (five ? " topology" : ""), base + "/commands/all stop"));
  EXPECT_EQ(device.last_qos(), qos);
  device.publish(base + "/state", "", true);
}

INSTANTIATE_TEST_SUITE_P(All, MqttVersions,
                         ::testing::Combine(::testing::Values("3.1.1", "5"), ::testing::Values(0, 1, 2)),
                         [](const auto& of) {
                           const bool five = std::string(std::get<0>(of.param)) == "5";
                           return (five ? "five_qos_" : "three_qos_") + std::to_string(std::get<1>(of.param));
                         });

TEST(Mqtt, gets_what_came_while_the_driver_was_away_and_sends_what_waited) {
  Device device(test_name() + "/orders");
  const auto hub = connected<MqttDriver>({{"subscribe", test_name() + "/readings"},
                                          {"version", "5"},
                                          {"while_away", "keep"},
                                          {"publish_topic", test_name() + "/orders"}});
  until_subscribed(*hub, device, "messages", test_name() + "/readings");
  // The broker writes its sessions to disk after a message has come, and only then reads the message's release, whose
  // answer ends publish(). So the subscription is on disk.
  device.publish(test_name() + "/nothing", "");
  shared_broker().kill();
  ASSERT_TRUE(until_metadata(*hub, "connection", "away"));
  ASSERT_TRUE(hub->deliver("publish", command("kept")));
  shared_broker().start();
  // The device connects sooner than the driver.
  ASSERT_TRUE(tests::eventually([&] {
    device.publish(test_name() + "/readings", "late");
    return true;
  }));
  hub->host().advance(20ms);
  ASSERT_TRUE(until(*hub, [&] {
    hub->host().advance(1ms);
    return hub->host().metadata()["connection"] == "connected";
  }));
  ASSERT_TRUE(until(*hub, [&] { return ::testing::Matches(Contains("late"))(texts(*hub, "messages")); }));
  ASSERT_TRUE(
      until(*hub, [&] { return ::testing::Matches(Contains(test_name() + "/orders kept"))(device.received()); }));
  device.publish(test_name() + "/readings", "", true);
}

TEST(Mqtt, reads_no_further_while_a_channel_is_full_and_goes_on_sending) {
  Device device(test_name() + "/orders");
  const auto hub = connected<MqttDriver>({{"subscribe", test_name() + "/readings, " + test_name() + "/other=other"},
                                          {"publish_topic", test_name() + "/orders"}});
  until_subscribed(*hub, device, "messages", test_name() + "/readings");
  hub->host().answer_publish("messages", PublishStatus::would_block);
  for (int i = 0; i < 50; ++i) device.publish(test_name() + "/readings", std::to_string(i));
  device.publish(test_name() + "/other", "behind them");
  ASSERT_TRUE(hub->deliver("publish", command("still")));
  ASSERT_TRUE(until(*hub, [&] { return device.received().size() == 1; }));
  ASSERT_TRUE(until(*hub, [&] { return hub->host().poll_descriptors(20ms) == 0; })) << "the rest is the broker's";
  EXPECT_TRUE(hub->host().published("messages").empty());
  EXPECT_TRUE(hub->host().published("other").empty());
  hub->host().answer_publish("messages", PublishStatus::accepted);
  ASSERT_TRUE(hub->writable("messages"));
  ASSERT_TRUE(until_published(*hub, "messages", 50));
  ASSERT_TRUE(until_published(*hub, "other", 1));
  const auto all = texts(*hub, "messages");
  for (int i = 0; i < 50; ++i) EXPECT_EQ(all[static_cast<std::size_t>(i)], std::to_string(i));
  device.publish(test_name() + "/readings", "", true);
}

TEST(Mqtt, loses_no_message_that_it_cannot_send_without_saying_so) {
  Device device(test_name() + "/#");
  const auto hub =
      connected<MqttDriver>({{"most_bytes", "10"}, {"unsent_bytes", "100"}, {"subscribe", test_name() + "/readings"}});
  until_subscribed(*hub, device, "messages", test_name() + "/readings");
  device.publish(test_name() + "/readings", "longer than ten");
  device.publish(test_name() + "/readings", "short");
  ASSERT_TRUE(until_published(*hub, "messages", 1));
  EXPECT_THAT(texts(*hub, "messages"), ElementsAre("short"));
  EXPECT_EQ(hub->host().logged_count("is longer than most_bytes"), 1U);
  ASSERT_TRUE(hub->deliver("publish", command("x")));
  EXPECT_EQ(hub->host().logged_count("nobody knows its topic"), 1U);
  const auto retained = [&](const std::string& text) {
    Message message = command(text);
    message.properties.set("topic", test_name() + "/kept");
    message.properties.set("retain", "true");
    return message;
  };
  ASSERT_TRUE(hub->deliver("publish", retained("state")));
  ASSERT_TRUE(
      until(*hub, [&] { return ::testing::Matches(Contains(test_name() + "/kept state"))(device.received()); }));
  Device later(test_name() + "/kept");
  EXPECT_TRUE(tests::eventually([&] { return later.received().size() == 1; }));
  ASSERT_TRUE(hub->deliver("publish", retained("")));
  device.publish(test_name() + "/readings", "", true);
}

TEST(Mqtt, says_that_a_broker_hangs) {
  shared_broker().pause();
  MockInstance other(mqtt_plugin(), {{"url", shared_broker().url()}});
  ASSERT_TRUE(other.start()) << other.error();
  // The kernel answers for the broker, which does not.
  ASSERT_GT(other.host().poll_descriptors(60s), 0U);
  other.host().advance(11s);
  EXPECT_THAT(other.host().metadata()["connection_problem"], HasSubstr("does not answer"));
  shared_broker().resume();
}

TEST(Mqtt, has_tls_certificates_and_a_password) {
  const tests::PrivateServer guarded("mosquitto.py", {"--tls"});
  const auto file = [&](const std::string& name) { return (guarded.folder() / name).string(); };
  PropertyMap properties{
      {"url", guarded.url()},
      {"ca", file("ca.pem")},
      {"certificate", file("client.pem")},
      {"key", file("client.key")},
      {"user", tests::server_user},
      {"password_file", tests::write_file(file("password"), std::string(tests::server_password) + "\n")},
      {"subscribe", "loop"},
      {"publish_topic", "loop"}};
  const auto hub = connected<MqttDriver>(properties);
  ASSERT_TRUE(until(*hub, [&] {
    EXPECT_TRUE(hub->deliver("publish", command("secret")));
    return !hub->host().published("messages").empty();
  }));
  const auto problem_with = [&](const std::string& property, const std::string& value) {
    PropertyMap wrong = properties;
    wrong[property] = value;
    MockInstance instance(mqtt_plugin(), wrong);
    EXPECT_TRUE(instance.start()) << instance.error();
    EXPECT_TRUE(until(
        instance, [&] { return instance.host().metadata()["connection_problem"] != "it has not been reached yet"; }));
    return instance.host().metadata()["connection_problem"];
  };
  EXPECT_THAT(problem_with("password_file", tests::write_file(file("wrong"), "guess\n")),
              HasSubstr("refuses the session"));
  std::string other_name = guarded.url();
  other_name.replace(other_name.find("localhost"), 9, "127.1");  // the same address, and no name of the certificate
  EXPECT_THAT(problem_with("url", other_name), HasSubstr("TLS"));
  EXPECT_THAT(problem_with("ca", "/etc/ssl/certs/ca-certificates.crt"), HasSubstr("TLS"));
}

TEST(Mqtt, says_which_property_is_wrong) {
  const auto error_with = [](PropertyMap properties) {
    properties.try_emplace("url", "mqtt://127.0.0.1");
    MockInstance instance(mqtt_plugin(), properties);
    EXPECT_FALSE(instance.open());
    return instance.error();
  };
  EXPECT_THAT(error_with({{"url", "tcp://a"}}), HasSubstr("mqtts://HOST"));
  EXPECT_THAT(error_with({{"url", "mqtt://a:b"}}), HasSubstr("HOST:PORT"));
  EXPECT_THAT(error_with({{"subscribe", "a/#/b"}}), HasSubstr("FILTER=CHANNEL"));
  EXPECT_THAT(error_with({{"subscribe", "a=publish"}}), HasSubstr("no channel \"publish\""));
  EXPECT_THAT(error_with({{"ca", "x"}}), HasSubstr("mqtts://"));
  EXPECT_THAT(error_with({{"url", "mqtts://a"}, {"ca", "/no/such"}}), HasSubstr("cannot be read"));
  EXPECT_THAT(error_with({{"url", "mqtts://a"}, {"key", "x"}}), HasSubstr("both"));
  EXPECT_THAT(error_with({{"user", "u"}, {"password_file", "/no/such"}}), HasSubstr("/no/such"));
  EXPECT_THAT(error_with({{"version", "4"}}), HasSubstr("3.1.1"));
  EXPECT_EQ(read_subscriptions(" a/+=x ,, $share/g/b/# "),
            (std::vector<Subscription>{{"a/+", "x"}, {"$share/g/b/#", "messages"}}));
}

}  // namespace
}  // namespace iotcloud::drivers::mqtt
