// What announcements of devices mean, without a broker.
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/drivers/mqtt/finder/announcements.h>

namespace iotcloud::drivers::mqtt {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Key;
using ::testing::Not;
using ::testing::SizeIs;

class AnnouncementsTest : public ::testing::Test {
 protected:
  Findings findings() {
    return {[this](const std::string& key, const PropertyMap& attributes) { found_[key] = attributes; },
            [this](const std::string& key) { found_.erase(key); },
            [this](const std::string& text) { warnings_.push_back(text); }};
  }
  const PropertyMap& only() const {
    EXPECT_THAT(found_, SizeIs(1));
    static const PropertyMap none;
    return found_.empty() ? none : found_.begin()->second;
  }

  std::map<std::string, PropertyMap> found_;
  std::vector<std::string> warnings_;
  PlainAnnouncements plain_{findings()};
  HomeAssistant house_{"homeassistant", findings()};
};

TEST_F(AnnouncementsTest, of_objects_are_their_texts_numbers_and_flags) {
  plain_.take("hello/7", R"({"id":"meter-7","port":1502,"tls":true,"deep":{"a":1},"kind":"mine","topic":"other"})");
  EXPECT_EQ(only(),
            (PropertyMap{
                {"id", "meter-7"}, {"port", "1502"}, {"tls", "true"}, {"kind", "announcement"}, {"topic", "hello/7"}}));
  plain_.take("hello/8", "no object");
  EXPECT_THAT(warnings_, ElementsAre(HasSubstr("hello/8")));
  plain_.take("hello/7", "");
  EXPECT_THAT(found_, IsEmpty());
}

TEST_F(AnnouncementsTest, of_home_assistant_with_abbreviations_are_one_device) {
  house_.take("homeassistant/sensor/kitchen/temperature/config",
              R"({"~":"home/kitchen","stat_t":"~/temperature","avty_t":"~/lwt","uniq_id":"k1t","unit_of_meas":"C",
                  "dev":{"ids":["k1","serial-9"],"name":"Kitchen","mf":"Acme","mdl":"TH-2","sw":"1.4","sa":"kitchen"}})");
  house_.take(
      "homeassistant/light/kitchen/lamp/config",
      R"({"state_topic":"home/kitchen/lamp","cmd_t":"home/kitchen/lamp/set","bri_cmd_t":"home/kitchen/lamp/level/set",
                  "bri_stat_t":"home/kitchen/lamp/level","device":{"identifiers":"k1"},
                  "avty":[{"t":"home/kitchen/other","pl_avail":"up","pl_not_avail":"down"}]})");
  const auto& device = only();
  EXPECT_EQ(device.at("kind"), "homeassistant");
  EXPECT_EQ(device.at("id"), "k1");
  EXPECT_EQ(device.at("name"), "Kitchen");
  EXPECT_EQ(device.at("manufacturer"), "Acme");
  EXPECT_EQ(device.at("model"), "TH-2");
  EXPECT_EQ(device.at("sw_version"), "1.4");
  EXPECT_EQ(device.at("suggested_area"), "kitchen");
  EXPECT_EQ(device.at("components"), "light sensor");
  EXPECT_EQ(device.at("subscribe"),
            "home/kitchen/lamp/level=lamp.brightness, home/kitchen/lamp=lamp, home/kitchen/temperature=temperature");
  EXPECT_EQ(device.at("publish_to"), "home/kitchen/lamp/set=lamp, home/kitchen/lamp/level/set=lamp.brightness");
  EXPECT_EQ(device.at("availability"), "home/kitchen/other");
  EXPECT_EQ(device.at("available"), "up");
  EXPECT_EQ(device.at("not_available"), "down");
  house_.take("homeassistant/light/kitchen/lamp/config", "");
  EXPECT_EQ(only().at("components"), "sensor");
  EXPECT_EQ(only().at("availability"), "home/kitchen/lwt");
  EXPECT_THAT(only(), Not(Contains(Key("publish_to"))));
  house_.take("homeassistant/sensor/kitchen/temperature/config", "");
  EXPECT_THAT(found_, IsEmpty());
}

TEST_F(AnnouncementsTest, of_entities_that_share_a_topic_are_one_channel) {
  for (const std::string entity : {"temperature", "humidity"})
    house_.take(
        "homeassistant/sensor/0x1/" + entity + "/config",
        R"({"state_topic":"zigbee2mqtt/plug","value_template":"{{ value_json.x }}","device":{"identifiers":["0x1"]}})");
  EXPECT_EQ(only().at("subscribe"), "zigbee2mqtt/plug=state");
}

TEST_F(AnnouncementsTest, of_whole_devices_have_their_components) {
  house_.take("homeassistant/device/bench/config",
              R"({"dev":{"ids":"b7","name":"Bench"},"o":{"name":"x"},"availability_topic":"b/status",
                  "cmps":{"t1":{"p":"sensor","state_topic":"b/t1"},"relay":{"p":"switch","stat_t":"b/r","cmd_t":"b/r/set"},
                          "gone":{"p":"sensor"}}})");
  EXPECT_EQ(only().at("id"), "b7");
  EXPECT_EQ(only().at("subscribe"), "b/r=relay, b/t1=t1");
  EXPECT_EQ(only().at("publish_to"), "b/r/set=relay");
  EXPECT_EQ(only().at("availability"), "b/status");
}

TEST_F(AnnouncementsTest, without_a_device_are_devices_of_their_own) {
  house_.take("homeassistant/sensor/lonely/config", R"({"state_topic":"l","unique_id":"u1","name":"Lonely"})");
  EXPECT_EQ(only().at("id"), "u1");
  EXPECT_EQ(only().at("name"), "Lonely");
  house_.take("homeassistant/sensor/bare/config", R"({"state_topic":"b"})");
  EXPECT_THAT(found_, Contains(Key("homeassistant sensor/bare")));
}

TEST_F(AnnouncementsTest, move_to_another_device) {
  house_.take("homeassistant/sensor/s/config", R"({"state_topic":"t","device":{"identifiers":"a"}})");
  house_.take("homeassistant/sensor/s/config", R"({"state_topic":"t","device":{"connections":[["mac","b"]]}})");
  EXPECT_EQ(only().at("id"), "b");
}

TEST_F(AnnouncementsTest, have_keys_that_give_no_more_than_a_name) {
  house_.take("homeassistant/light/l/config", R"({"uniq_id":"l","a=b, #=c/d_stat_t":"home/l"})");
  EXPECT_EQ(only().at("subscribe"), "home/l=l.a_b____c_d");
}

TEST_F(AnnouncementsTest, of_strangers_cannot_bring_in_other_topics) {
  house_.take(
      "homeassistant/sensor/s/config",
      R"({"state_topic":"#","json_attr_t":"a,$SYS/#=x","command_topic":"a=b","act_t":"fine","device":{"identifiers":"a"}})");
  EXPECT_EQ(only().at("subscribe"), "fine=s.action");
  EXPECT_THAT(only(), Not(Contains(Key("publish_to"))));
  EXPECT_FALSE(warnings_.empty());
}

TEST_F(AnnouncementsTest, that_are_hostile_are_passed_over) {
  const std::string topic = "homeassistant/sensor/s/config";
  for (const std::string bad : {"{", "[]", "7", "\"x\"", "{\"a\":\"\xff\"}"}) house_.take(topic, bad);
  house_.take(topic, "{\"a\":" + std::string(100'000, '[') + std::string(100'000, ']') + "}");
  house_.take("homeassistant/sensor/s/t/u/config", "{}");
  house_.take("homeassistant/config", "{}");
  house_.take("homeassistant/device/x/config", R"({"cmps":7})");
  for (const std::string odd :
       {R"({"device":7,"avty":[7],"stat_t":{}})", R"({"device":{"identifiers":[[]]},"avty":{}})",
        R"({"device":{"connections":[[]]},"~":7})"})
    house_.take(topic, odd);
  EXPECT_THAT(found_, SizeIs(1)) << "the last one has a topic that names it";
  std::string many = R"({"dev":{"ids":"m"},"cmps":{)";
  for (int i = 0; i < 300; ++i) many += (i == 0 ? "\"" : ",\"") + std::to_string(i) + R"(":{"p":"sensor"})";
  house_.take("homeassistant/device/m/config", many + "}}");
  EXPECT_THAT(found_, Not(Contains(Key("homeassistant m"))));
}

TEST_F(AnnouncementsTest, of_strangers_are_kept_up_to_a_bound) {
  HomeAssistant house("homeassistant", findings(), 1'000'000);
  std::string topics;
  for (int i = 0; i < 100; ++i) topics += ",\"a" + std::to_string(i) + "_topic\":\"" + std::string(1000, 'x') + "\"";
  const auto take = [&](int number) {
    const std::string id = std::to_string(number);
    house.take("homeassistant/sensor/" + id + "/config", R"({"device":{"identifiers":")" + id + "\"}" + topics + "}");
  };
  for (int i = 0; i < 10; ++i) take(i);
  EXPECT_THAT(warnings_, Contains(HasSubstr("one too many")));
  EXPECT_THAT(found_, Not(Contains(Key("homeassistant 9"))));
  for (int i = 0; i < 5; ++i) house.take("homeassistant/sensor/" + std::to_string(i) + "/config", "");
  take(9);
  EXPECT_THAT(found_, Contains(Key("homeassistant 9"))) << "there is room";
  house.take("homeassistant/sensor/n/config",
             R"({"device":{"identifiers":"n","name":")" + std::string(5000, 'x') + "\"}}");
  EXPECT_THAT(found_.at("homeassistant n"), Not(Contains(Key("name"))));
}

}  // namespace
}  // namespace iotcloud::drivers::mqtt
