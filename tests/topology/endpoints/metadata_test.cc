// What a message carries beside its payload, and what builders make of the payload.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>

namespace iotcloud::topology {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// Writes what it got into the field `text`, and passes on two properties.
class Show final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"text", "driverID", "battery", "none"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const std::string battery = tuple.at("battery").index() == 0 ? "null" : tuple.get<std::string>("battery");
    collector.emit(Values(tuple.get<std::string>("gatewayID") + " " + tuple.get<std::string>("channel") + " " +
                              (tuple.get<bool>("redelivered") ? "again " : "first ") + battery,
                          tuple.at("driverID"), tuple.at("battery"), tuple.at("none")));
  }
};

/// Fails each tuple once.
class FailFirst final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"text", "driverID"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    if (!tuple.get<bool>("redelivered")) throw std::runtime_error("the first time");
    collector.emit(Values("redelivered", tuple.at("driverID")));
  }
};

/// "3 on" is the number 3 and whether something is on; the message back is "on 3", with the property `unit`.
class Words final : public MessageBuilder {
 public:
  Values read(const brokers::Message& message, const Fields& fields) override {
    EXPECT_EQ(fields, Fields({"number", "on"}));
    const std::string text(message.payload.text());
    const auto blank = text.find(' ');
    if (blank == std::string::npos) throw std::runtime_error("there is no blank in it");
    return Values(std::stol(text.substr(0, blank)), text.substr(blank + 1) == "on");
  }
  void write(const Tuple& tuple, const Fields& fields, brokers::Message& message) override {
    EXPECT_EQ(fields, Fields({"number", "on"}));
    message.payload =
        Payload::copy((tuple.get<bool>("on") ? "on " : "off ") + std::to_string(tuple.get<std::int64_t>("number")));
    message.properties.set("unit", "V");
  }
};
/// Makes too few values.
class Short final : public MessageBuilder {
 public:
  Values read(const brokers::Message&, const Fields&) override { return Values("one"); }
};

class MessageFields : public Endpoints {
 protected:
  Worker& run_between(const std::string& spout, const std::string& between, const std::string& bolt) {
    ComponentRegistry components;
    components.add_bolt<Show>("Show");
    components.add_bolt<FailFirst>("FailFirst");
    components.add_builder<Words>("test.Words");
    components.add_builder<Short>("test.Short");
    return run_yaml("topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, " + spout +
                        "}\nbolts:\n" +
                        (between.empty() ? "" : "  between: {class: " + between + ", inputs: {from: in}}\n") +
                        "  out: {broker: rabbitmq, driver: d, channel: down, " + bolt +
                        ", inputs: {from: " + (between.empty() ? "in" : "between") + "}}\n",
                    std::move(components));
  }
};

TEST_F(MessageFields, NameTheGatewayTheChannelAndCustomPropertiesAndABoltSetsProperties) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run_between(
      "fields: [p, driverID, gatewayID, channel, redelivered, {property: x-charge, as: battery}, {property: none}]",
      "Show", "builder: text, fields: [text, driverID, {property: battery}, {property: none}]");
  show_driver("one");
  const auto publisher = device("one");
  brokers::Message full = message("x", "one");
  full.gateway_id = "g";
  full.properties.set("x-charge", "87");
  publisher->publish(full);
  publisher->publish(message("x", "one"));
  ASSERT_TRUE(mailbox.wait_for(2));
  EXPECT_THAT(mailbox.texts(), ElementsAre("g up first 87", "g up first null"));
  ASSERT_EQ(mailbox.message(0).properties.size(), 1U);
  EXPECT_EQ(*mailbox.message(0).properties.find("battery"), "87");
  EXPECT_TRUE(mailbox.message(1).properties.empty()) << "a property of null is not sent";
}

TEST_F(MessageFields, SayThatAMessageIsTriedAgain) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run_between("fields: [p, driverID, redelivered]", "FailFirst", "builder: text, fields: [text, driverID]");
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("x", "one"));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_THAT(mailbox.texts(), ElementsAre("redelivered"));
}

TEST_F(MessageFields, AreMadeByABuilderOfTheTopologysLibraryAndTurnedBack) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  run_between("builder: test.Words, fields: [driverID, number, time, on]", "",
              "builder: test.Words, fields: [number, driverID, on, time]");
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("3 on", "one", 1234));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_EQ(mailbox.message(0).payload.text(), "on 3");
  EXPECT_EQ(mailbox.message(0).time_ms, 1234);
  EXPECT_EQ(*mailbox.message(0).properties.find("unit"), "V");
}

TEST_F(MessageFields, AMessageThatItsBuilderRefusesIsGivenUpAtOnceWithTheReason) {
  Mailbox mailbox(*broker_, topic("one", "down")), letters(*broker_, "letters", true);
  run_between("builder: test.Words, fields: [number, on, driverID], properties: {deadLetter: letters}", "",
              "builder: test.Words, fields: [number, on, driverID]");
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("nonsense", "one"));
  publisher->publish(message("4 off", "one"));
  ASSERT_TRUE(letters.wait_for(1));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_THAT(mailbox.texts(), ElementsAre("off 4"));
  const brokers::Message letter = letters.message(0);
  EXPECT_EQ(letter.payload.text(), "nonsense");
  EXPECT_EQ(*letter.properties.find("dead-letter-tries"), "1");
  EXPECT_THAT(*letter.properties.find("dead-letter-reason"),
              testing::AllOf(HasSubstr("test.Words"), HasSubstr("there is no blank in it")));
  EXPECT_EQ(metric("iotcloud_spout_unreadable_total"), 1);
  EXPECT_EQ(metric("iotcloud_spout_retried_total"), 0);
}

TEST_F(MessageFields, ABuilderThatMakesTooFewValuesRefusesTheMessage) {
  run_between("builder: test.Short, fields: [a, b, driverID]", "", "builder: json, fields: [a, driverID]");
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message("x", "one"));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_rejected_total") == 1; }));
  EXPECT_EQ(metric("iotcloud_spout_unreadable_total"), 1);
}

TEST_F(MessageFields, AreTheKeysOfAJsonObject) {
  Mailbox mailbox(*broker_, topic("one", "down"));
  const std::string keys = "[name, level, share, on, nothing, missing, driverID, list]";
  run_between("builder: json, fields: " + keys, "", "builder: json, fields: " + keys);
  show_driver("one");
  const auto publisher = device("one");
  publisher->publish(message(
      R"({"level": -3, "list": [1, {"a": 2}], "more": 1, "name": "B\u00fcro", "nothing": null, "on": true, "share": 0.5})",
      "one"));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_THAT(mailbox.texts(),
              ElementsAre("{\"name\":\"B\u00fcro\",\"level\":-3,\"share\":0.5,\"on\":true,\"nothing\":null,"
                          "\"missing\":null,\"list\":\"[1,{\\\"a\\\":2}]\"}"));
}

TEST_F(MessageFields, APayloadThatIsNoJsonObjectIsGivenUp) {
  run_between("builder: json, fields: [a, driverID]", "", "builder: json, fields: [a, driverID]");
  show_driver("one");
  const auto publisher = device("one");
  for (const std::string& text :
       {std::string("{\"a\": "), std::string("[1]"), std::string("{\"a\": 18446744073709551615}"),
        "{\"a\": " + std::string(100, '[') + std::string(100, ']') + "}", std::string("{\"a\": \"\xff\"}")}) {
    publisher->publish(message(text, "one"));
  }
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_unreadable_total") == 5; }));
}

}  // namespace
}  // namespace iotcloud::topology
