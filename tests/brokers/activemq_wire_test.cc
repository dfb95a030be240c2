// How messages and names look on ActiveMQ's wire.
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <proton/types.hpp>

#include "iotcloud/brokers/activemq/names.h"
#include "iotcloud/brokers/activemq/statistics.h"
#include "iotcloud/brokers/activemq/wire_message.h"

namespace iotcloud::brokers::activemq {
namespace {

using testing::HasSubstr;
using testing::Not;

proton::message through_the_wire(const proton::message& message) {
  proton::message received;
  received.decode(message.encode());
  return received;
}

Message filled() {
  Message message;
  message.payload = Payload::copy(std::string_view("body\0x", 6));
  message.driver_id = "driver";
  message.gateway_id = "gateway";
  message.time_ms = 1'700'000'000'123;
  return message;
}

void expect_unchanged(const Message& message) {
  const auto arrived = from_wire(through_the_wire(to_wire(message, {})));
  ASSERT_TRUE(arrived);
  EXPECT_EQ(arrived->message.payload, message.payload);
  EXPECT_EQ(arrived->message.driver_id, message.driver_id);
  EXPECT_EQ(arrived->message.gateway_id, message.gateway_id);
  EXPECT_EQ(arrived->message.time_ms, message.time_ms);
  EXPECT_EQ(arrived->message.properties, message.properties);
  EXPECT_FALSE(arrived->redelivered);
}

TEST(ActiveMqMessage, CarriesPropertiesInTheirOrder) {
  Message message = filled();
  message.properties.set("zebra", "1");
  message.properties.set("ant", "2");
  message.properties.set("m&m=s", "");
  expect_unchanged(message);
}

TEST(ActiveMqMessage, CarriesNamesAndValuesOfAnyBytes) {
  Message message = filled();
  std::string all_bytes;
  for (int c = 0; c < 256; ++c) all_bytes += static_cast<char>(c);
  message.driver_id = all_bytes;
  message.gateway_id = "\xff";
  message.properties.set("all", all_bytes);
  message.properties.set(all_bytes, "all");
  message.properties.set("", "no name");
  for (const char* name :
       {"JMSPriority", "AMQ_SCHEDULED_DELAY", "iotcloud_unknown", "overlong\xc0\x80", "\xed\xa0\x80"}) {
    message.properties.set(name, "9");
  }
  expect_unchanged(message);
}

TEST(ActiveMqMessage, IsABytesMessageWithTheOriginalsPropertiesForJms) {
  Message message = filled();
  message.properties.set("unit", "mm");
  message.properties.set("JMSPriority", "9");
  const proton::message wire = through_the_wire(to_wire(message, {.to = "queue://q", .durable = true, .priority = 7}));
  EXPECT_EQ(wire.body().type(), proton::BINARY);
  EXPECT_TRUE(wire.inferred()) << "a data section";
  std::map<std::string, proton::scalar> properties;
  proton::get(wire.properties().value(), properties);
  EXPECT_EQ(proton::get<std::string>(properties["sensorID"]), "driver");
  EXPECT_EQ(proton::get<std::string>(properties["siteID"]), "gateway");
  EXPECT_EQ(proton::get<std::string>(properties["unit"]), "mm");
  EXPECT_EQ(properties.count("JMSPriority"), 0U) << "it would mean something";
  EXPECT_TRUE(wire.durable());
  EXPECT_EQ(wire.priority(), 7);
}

TEST(ActiveMqMessage, OneThatWasSentBeforeSaysSo) {
  const auto arrived = from_wire(through_the_wire(to_wire(filled(), {.to = "", .resent = true})));
  ASSERT_TRUE(arrived);
  EXPECT_TRUE(arrived->redelivered);
  EXPECT_TRUE(arrived->message.properties.empty());
}

TEST(ActiveMqMessage, PropertiesOfOddTypesBecomeTextAndNestedOnesAreSkipped) {
  proton::message wire;
  wire.body() = std::string("text");
  std::map<proton::value, proton::value> odd;
  odd[std::string("time")] = std::int64_t{77};
  odd[std::string("flag")] = true;
  odd[std::string("small")] = std::int8_t{-3};
  odd[std::string("double")] = 0.5;
  odd[std::string("binary")] = proton::binary{1, 2};
  odd[std::string("list")] = std::vector<std::int32_t>{1, 2};
  odd[std::int32_t{5}] = std::string("numbered");
  wire.properties().value() = odd;  // proton would not send it
  const auto arrived = from_wire(wire);
  ASSERT_TRUE(arrived);
  EXPECT_EQ(arrived->message.payload.text(), "text");
  EXPECT_EQ(arrived->message.time_ms, 77);
  const Properties& properties = arrived->message.properties;
  EXPECT_EQ(*properties.find("flag"), "true");
  EXPECT_EQ(*properties.find("small"), "-3");
  EXPECT_EQ(*properties.find("double"), "0.5");
  EXPECT_EQ(*properties.find("binary"), "\x01\x02");
  EXPECT_EQ(*properties.find("5"), "numbered");
  EXPECT_EQ(properties.find("list"), nullptr);
}

TEST(ActiveMqMessage, ABodyThatIsNeitherBytesNorTextIsNotCarried) {
  proton::message wire;
  wire.body() = std::map<std::string, proton::scalar>{{"k", 1}};
  EXPECT_FALSE(from_wire(through_the_wire(wire)));
}

TEST(ActiveMqMessage, AnIndexThatIsNonsenseDoesNoHarm) {
  for (const char* index : {"&&&", "=", "%", "%4", "%zz=%", "a=b&a&a=c", "sensorID=x&siteID"}) {
    proton::message wire = to_wire(filled(), {});
    std::map<std::string, proton::scalar> properties{{"iotcloud_properties", index}, {"a", "1"}};
    wire.properties() = properties;
    EXPECT_TRUE(from_wire(through_the_wire(wire))) << index;
  }
}

TEST(ActiveMqNames, GroupsReadQueuesOfAVirtualTopicAndNobodyTheTopicsOwn) {
  EXPECT_EQ(queue_of("gw.driver.depth", ""), "gw.driver.depth");
  EXPECT_EQ(queue_of("gw.driver.depth", "follower"), "Consumer.follower.VirtualTopic.gw.driver.depth");
  EXPECT_EQ(send_address("t", false), "topic://VirtualTopic.t");
  EXPECT_EQ(send_address("t", true), "queue://t,topic://VirtualTopic.t");
}

TEST(ActiveMqNames, WhatMeansSomethingToTheServerIsEncoded) {
  const std::string queue = queue_of("a,b?c*d>e f%", "g.h*");
  EXPECT_EQ(queue, "Consumer.g%2Eh%2A.VirtualTopic.a%2Cb%3Fc%2Ad%3Ee%20f%25");
  EXPECT_EQ(percent_decode(percent_encode("a,b\xff%", "")), "a,b\xff%");
}

TEST(ActiveMqStatistics, AnswersOfOthersAreNotTakenForOurs) {
  EXPECT_EQ(statistics_answer(proton::message()).question, 0U);
  proton::message odd;
  odd.correlation_id(std::string("7x"));
  odd.body() = std::map<std::string, proton::scalar>{{"destinationName", 5}, {"size", "many"}};
  EXPECT_EQ(statistics_answer(odd).question, 7U);
  EXPECT_FALSE(statistics_answer(odd).facts);
}

}  // namespace
}  // namespace iotcloud::brokers::activemq
