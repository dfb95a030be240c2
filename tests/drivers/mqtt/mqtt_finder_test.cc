// The finder and the driver of Sparkplug B against a real Mosquitto, devices that are bare clients, and an edge node in
// Python.
#include <chrono>
#include <memory>
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/drivers/mqtt/finder/mqtt_finder.h>
#include <iotcloud/drivers/mqtt/mqtt_driver.h>
#include <iotcloud/drivers/mqtt/sparkplug/sparkplug_driver.h>
#include <iotcloud/tests/drivers/mqtt/connected.h>
#include <iotcloud/tests/drivers/mqtt/device.h>
#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/servers/private_server.h>

namespace iotcloud::drivers::mqtt {
namespace {

using namespace std::chrono_literals;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Key;
using testing::MockInstance;

bool until_found(MockInstance& finder, const std::string& key) {
  return until(finder, [&] { return finder.host().found().contains(key); });
}

bool until_gone(MockInstance& finder, const std::string& key) {
  return until(finder, [&] { return !finder.host().found().contains(key); });
}

TEST(MqttFinder, finds_devices_that_announce_themselves_and_sees_that_they_go) {
  Device device(shared_broker().url());
  device.publish("ha1/sensor/kitchen/config", R"({"stat_t":"k/t","dev":{"ids":["k1"],"mdl":"TH"}})", true);
  device.publish("hello/meter", R"({"id":"meter","port":1502})", true);
  const auto finder = connected<MqttFinder>(
      {{"find", "homeassistant, announcements"}, {"homeassistant_prefix", "ha1"}, {"announcements", "hello/+"}});
  EXPECT_TRUE(finder->host().sees());
  ASSERT_TRUE(until_found(*finder, "homeassistant k1"));
  ASSERT_TRUE(until_found(*finder, "announcement hello/meter"));
  EXPECT_EQ(finder->host().found()["homeassistant k1"].at("subscribe"), "k/t=kitchen");
  EXPECT_EQ(finder->host().found()["announcement hello/meter"].at("port"), "1502");
  device.publish("ha1/sensor/kitchen/config", "", true);
  device.publish("hello/meter", "", true);
  EXPECT_TRUE(until_gone(*finder, "homeassistant k1"));
  EXPECT_TRUE(until_gone(*finder, "announcement hello/meter"));
}

TEST(MqttFinder, does_not_see_while_the_broker_is_away_and_finds_all_again_after_that) {
  tests::PrivateServer broker("mosquitto.py");
  auto device = std::make_unique<Device>(broker.url());
  device->publish("homeassistant/sensor/stays/config", R"({"stat_t":"a","uniq_id":"stays"})", true);
  device->publish("homeassistant/sensor/goes/config", R"({"stat_t":"b","uniq_id":"goes"})", true);
  const auto finder = connected<MqttFinder>({{"find", "homeassistant"}, {"url", broker.url()}});
  ASSERT_TRUE(until_found(*finder, "homeassistant stays"));
  ASSERT_TRUE(until_found(*finder, "homeassistant goes"));
  device.reset();
  broker.kill();
  ASSERT_TRUE(until(*finder, [&] { return !finder->host().sees(); }));
  EXPECT_EQ(finder->host().found().size(), 2U) << "nothing counts as gone";
  broker.start();
  Device(broker.url()).publish("homeassistant/sensor/goes/config", "", true);
  ASSERT_TRUE(until(*finder, [&] {
    finder->host().advance(1ms);
    return finder->host().sees();
  }));
  ASSERT_TRUE(until_found(*finder, "homeassistant stays"));
  EXPECT_EQ(finder->host().found().size(), 1U);
}

TEST(MqttFinder, refuses_what_it_cannot_find) {
  const auto refusal = [](PropertyMap properties) {
    properties["url"] = "mqtt://127.0.0.1:1";
    MockInstance instance(describe<MqttFinder>("mqtt_finder", "test", true), properties);
    EXPECT_FALSE(instance.start());
    return instance.error();
  };
  EXPECT_THAT(refusal({{"find", "sparkplug"}, {"reconnect_ms", "900"}, {"reconnect_most_ms", "800"}}),
              HasSubstr("at least reconnect_ms, 900"));
  EXPECT_THAT(refusal({{"find", "zigbee"}}), HasSubstr("homeassistant, sparkplug and announcements"));
  EXPECT_THAT(refusal({{"find", "announcements"}}), HasSubstr("give both or none"));
  EXPECT_THAT(refusal({{"find", "homeassistant"}, {"homeassistant_prefix", "#"}}), HasSubstr("no topic"));
}

TEST(MqttFinder, asks_nodes_of_sparkplug_for_births_and_finds_their_devices) {
  tests::PrivateServer node("edge_node.py", {shared_broker().url(), "plant", "edge1"});
  const auto finder = connected<MqttFinder>({{"find", "sparkplug"}});
  ASSERT_TRUE(until(*finder, [&] {
    node.command("data 1", "OK");  // nobody has heard its birth certificates
    return finder->host().found().contains("sparkplug plant/edge1");
  }));
  ASSERT_TRUE(until_found(*finder, "sparkplug plant/edge1/sensor"));
  const auto device = finder->host().found()["sparkplug plant/edge1/sensor"];
  EXPECT_EQ(device.at("kind"), "sparkplug-device");
  EXPECT_EQ(device.at("group"), "plant");
  EXPECT_EQ(device.at("device"), "sensor");
  EXPECT_EQ(device.at("property.Hardware_Make"), "Acme");
  EXPECT_THAT(node.asked("heard"), HasSubstr("NCMD Node Control/Rebirth=True"));
  node.command("device-death", "OK");
  EXPECT_TRUE(until_gone(*finder, "sparkplug plant/edge1/sensor"));
  EXPECT_TRUE(finder->host().found().contains("sparkplug plant/edge1"));
  node.kill();  // the broker publishes its last will
  EXPECT_TRUE(until_gone(*finder, "sparkplug plant/edge1"));
}

TEST(Sparkplug, devices_tell_their_metrics_by_name_and_take_commands) {
  tests::PrivateServer node("edge_node.py", {shared_broker().url(), "plant", "edge2"});
  const auto sensor =
      connected<sparkplug::SparkplugDriver>({{"group", "plant"}, {"node", "edge2"}, {"device", "sensor"}});
  ASSERT_TRUE(until_metadata(*sensor, "alive", "true")) << "it asked for the birth certificate";
  node.command("data 22.5", "OK");
  const auto told = [&](const std::string& part) {
    return until(*sensor, [&] {
      const auto all = texts(*sensor, "metrics");
      return !all.empty() && all.back().find(part) != std::string::npos;
    });
  };
  EXPECT_TRUE(told(R"("name":"Temperature")"));
  EXPECT_TRUE(told(R"("type":"Double","value":22.5)"));
  Message set = command("23");
  set.properties.set("metric", "Setpoint");
  ASSERT_TRUE(sensor->deliver("commands", set));
  EXPECT_TRUE(until(*sensor, [&] { return node.asked("heard").find("DCMD Setpoint=23") != std::string::npos; }));
  set.payload = Payload::copy("warm");
  ASSERT_TRUE(sensor->deliver("commands", set));
  EXPECT_EQ(sensor->host().logged_count("\"warm\" is no Int64"), 1U);
  node.command("device-death", "OK");
  EXPECT_TRUE(until_metadata(*sensor, "alive", "false"));
  EXPECT_TRUE(told(R"("kind":"death")"));
}

TEST(Sparkplug, nodes_are_asked_for_births_when_a_number_is_missing_and_die_by_their_last_will) {
  tests::PrivateServer node("edge_node.py", {shared_broker().url(), "plant", "edge3"});
  const auto edge = connected<sparkplug::SparkplugDriver>({{"group", "plant"}, {"node", "edge3"}});
  ASSERT_TRUE(until_metadata(*edge, "alive", "true"));
  edge->host().advance(10s);  // it may ask again
  const auto births = [&] {
    std::size_t count = 0;
    for (const auto& text : texts(*edge, "metrics"))
      count += text.find(R"("kind":"birth")") != std::string::npos ? 1 : 0;
    return count;
  };
  ASSERT_TRUE(until(*edge, [&] { return births() == 1; }));
  node.command("skip", "OK");
  node.command("data 1", "OK");
  EXPECT_TRUE(until(*edge, [&] { return births() == 2; }));
  node.kill();
  EXPECT_TRUE(until_metadata(*edge, "alive", "false"));
  node.start();
  node.command("birth", "OK");
  EXPECT_TRUE(until_metadata(*edge, "alive", "true"));
}

TEST(Mqtt, sends_to_names_and_says_whether_the_device_is_there) {
  Device device(shared_broker().url(), "lamp/set");
  const auto lamp = connected<MqttDriver>({{"subscribe", "lamp/state"},
                                           {"publish_to", "lamp/set=lamp"},
                                           {"availability", "lamp/lwt"},
                                           {"available", "up"},
                                           {"not_available", "down"}});
  device.publish("lamp/lwt", "up", true);
  ASSERT_TRUE(until_metadata(*lamp, "available", "true"));
  device.publish("lamp/lwt", "down", true);
  ASSERT_TRUE(until_metadata(*lamp, "available", "false"));
  Message on = command("ON");
  on.properties.set("to", "lamp");
  ASSERT_TRUE(lamp->deliver("publish", on));
  ASSERT_TRUE(until(*lamp, [&] { return device.received().size() == 1; }));
  EXPECT_EQ(device.received()[0], "lamp/set ON");
  on.properties.set("to", "fan");
  ASSERT_TRUE(lamp->deliver("publish", on));
  EXPECT_EQ(lamp->host().logged_count("no topic for \"fan\""), 1U);
  device.publish("lamp/lwt", "", true);
}

}  // namespace
}  // namespace iotcloud::drivers::mqtt
