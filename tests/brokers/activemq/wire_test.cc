// Messages and names on ActiveMQ's wire: this project's, proton's, and invalid ones.
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <proton/message.hpp>
#include <proton/types.hpp>
#include <pthread.h>

#include "iotcloud/brokers/activemq/names.h"
#include "iotcloud/brokers/activemq/wire/amqp_value.h"
#include "iotcloud/brokers/activemq/wire/sections.h"
#include "iotcloud/brokers/activemq/wire/statistics.h"
#include "iotcloud/brokers/activemq/wire/wire_message.h"

namespace iotcloud::brokers::activemq {
namespace {

std::string to_wire(const Message& message, const Envelope& envelope) {
  std::string bytes;
  write_head(message, envelope, bytes);
  return bytes + std::string(message.payload.text());
}

std::optional<client::Arrived> from_bytes(const std::string& bytes) {
  const auto owner = std::make_shared<const std::string>(bytes);
  return from_wire({owner, *owner});
}

/// The message as proton reads and writes it.
proton::message decoded(const std::string& bytes) {
  proton::message message;
  message.decode({bytes.begin(), bytes.end()});
  return message;
}

std::string encoded(const proton::message& message) {
  const std::vector<char> bytes = message.encode();
  return {bytes.begin(), bytes.end()};
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
  for (const std::string& bytes : {to_wire(message, {}), encoded(decoded(to_wire(message, {})))}) {
    const auto arrived = from_bytes(bytes);
    ASSERT_TRUE(arrived);
    EXPECT_EQ(arrived->message.payload, message.payload);
    EXPECT_EQ(arrived->message.driver_id, message.driver_id);
    EXPECT_EQ(arrived->message.gateway_id, message.gateway_id);
    EXPECT_EQ(arrived->message.time_ms, message.time_ms);
    EXPECT_EQ(arrived->message.properties, message.properties);
    EXPECT_FALSE(arrived->redelivered);
  }
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
  const proton::message wire = decoded(
      to_wire(message, {.to = "queue://q", .durable = true, .priority = 7, .expires_in = std::chrono::seconds(3)}));
  EXPECT_EQ(wire.to(), "queue://q");
  EXPECT_EQ(wire.ttl().milliseconds(), 3000U);
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
  const auto arrived = from_bytes(to_wire(filled(), {.to = "", .resent = true}));
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
  odd[std::string("large")] = std::uint64_t{18'446'744'073'709'551'615U};
  odd[std::string("single")] = 0.1F;
  odd[std::string("double")] = 0.5;
  odd[std::string("moment")] = proton::timestamp(-5);
  odd[std::string("binary")] = proton::binary{1, 2};
  odd[std::string("symbol")] = proton::symbol("word");
  odd[std::string("uuid")] = proton::uuid::random();
  odd[std::string("list")] = std::vector<std::int32_t>{1, 2};
  odd[std::int32_t{5}] = std::string("numbered");
  proton::value map;
  map = odd;
  std::string bytes;
  {
    proton::message carrier;  // proton does not write such properties
    carrier.body() = map;
    bytes = encoded(carrier);
    const auto value_section = bytes.find(std::string("\0\x53\x77", 3));
    ASSERT_NE(value_section, std::string::npos);
    bytes[value_section + 2] = '\x74';
  }
  const std::string text = encoded(wire);
  const auto arrived = from_bytes(bytes + text.substr(text.find(std::string("\0\x53\x77", 3))));
  ASSERT_TRUE(arrived);
  EXPECT_EQ(arrived->message.payload.text(), "text");
  EXPECT_EQ(arrived->message.time_ms, 77);
  const Properties& properties = arrived->message.properties;
  EXPECT_EQ(*properties.find("flag"), "true");
  EXPECT_EQ(*properties.find("small"), "-3");
  EXPECT_EQ(*properties.find("large"), "18446744073709551615");
  EXPECT_EQ(*properties.find("single"), "0.1");
  EXPECT_EQ(*properties.find("double"), "0.5");
  EXPECT_EQ(*properties.find("moment"), "-5");
  EXPECT_EQ(*properties.find("binary"), "\x01\x02");
  EXPECT_EQ(*properties.find("symbol"), "word");
  EXPECT_EQ(*properties.find("5"), "numbered");
  EXPECT_EQ(properties.find("list"), nullptr);
  EXPECT_EQ(properties.find("uuid"), nullptr);
}

TEST(ActiveMqMessage, ABodyThatIsNeitherBytesNorTextIsNotCarried) {
  proton::message wire;
  wire.body() = std::map<std::string, proton::scalar>{{"k", 1}};
  EXPECT_FALSE(from_bytes(encoded(wire)));
}

TEST(ActiveMqMessage, ABodyInSeveralPartsIsOneBody) {
  const std::string part("\0\x53\x75\xa0\2ab", 7);
  const auto arrived = from_bytes(part + part);
  ASSERT_TRUE(arrived);
  EXPECT_EQ(arrived->message.payload.text(), "abab");
}

TEST(ActiveMqMessage, AnIndexThatIsNonsenseDoesNoHarm) {
  for (const char* index : {"&&&", "=", "%", "%4", "%zz=%", "a=b&a&a=c", "sensorID=x&siteID"}) {
    proton::message wire = decoded(to_wire(filled(), {}));
    std::map<std::string, proton::scalar> properties{{"iotcloud_properties", index}, {"a", "1"}};
    wire.properties() = properties;
    EXPECT_TRUE(from_bytes(encoded(wire))) << index;
  }
}

TEST(ActiveMqMessage, BytesThatAreNoAmqpAreRefusedWhereverTheyBreakOff) {
  Message message = filled();
  message.properties.set("unit", "mm");
  const std::string whole = to_wire(message, {.to = "queue://q"});
  int refused = 0;
  for (std::size_t length = 1; length < whole.size(); ++length) {
    if (!from_bytes(whole.substr(0, length))) ++refused;
  }
  // Between two sections a message may end.
  EXPECT_EQ(refused, static_cast<int>(whole.size()) - 1 - 3);
}

TEST(ActiveMqMessage, LengthsAndCountsThatLieAreRefused) {
  const std::string properties("\0\x53\x74", 3);
  for (const std::string& bytes : {
           std::string("garbage"), std::string("\0\x53\x99\x40", 4),     // no such section
           std::string("\0\x53\x75\xb0\xff\xff\xff\xff", 8),             // 4 GB of body
           properties + std::string("\xd1\0\0\0\4\xff\xff\xff\xff", 9),  // 4 billion entries
           properties + std::string("\xc1\2\1\x40", 4),                  // a key without a value
           properties + std::string("\xc1\3\2\xa1\x09", 5),              // a key that is too long
           properties + std::string("\xc1\0", 2),                        // no count
           properties + std::string("\xa1\1x", 3),                       // not a map
           properties + std::string("\xc1\3\2\x01\x40", 5),              // no such type
           std::string("\0\x53\x77", 3) + std::string(1'000'000, '\0'),  // described by described by...
           std::string("\0\x53\x77\x40", 4) + std::string("\0\x53", 2),  // a section without an end
       }) {
    EXPECT_FALSE(from_bytes(bytes)) << testing::PrintToString(bytes.substr(0, 20));
  }
}

/// Runs `work` on a thread with a stack of 1 MiB.
void on_small_stack(std::function<void()> work) {
  pthread_attr_t attributes;
  ASSERT_EQ(pthread_attr_init(&attributes), 0);
  ASSERT_EQ(pthread_attr_setstacksize(&attributes, 1U << 20U), 0);
  pthread_t thread{};
  const auto run = [](void* what) -> void* {
    (*static_cast<std::function<void()>*>(what))();
    return nullptr;
  };
  ASSERT_EQ(pthread_create(&thread, &attributes, run, &work), 0);
  pthread_join(thread, nullptr);
  pthread_attr_destroy(&attributes);
}

std::string big_endian(std::size_t number) {
  std::string bytes;
  for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>(number >> shift & 0xffU);
  return bytes;
}

TEST(ActiveMqMessage, ListsInListsWithoutEndNeedNoStack) {
  // Each level: a list of one element, whose length is that of all that follows.
  constexpr std::size_t levels = 100'000;
  std::string nested;
  for (std::size_t inside = levels; inside > 0; --inside) nested += '\xd0' + big_endian(inside * 9 - 4) + big_endian(1);
  nested += '\x40';
  const std::string entry = "\xa1\x01p" + nested;
  const std::string bytes = std::string("\x00\x53\x74\xd1", 4) + big_endian(entry.size() + 4) + big_endian(2) + entry +
                            std::string("\x00\x53\x75\xa0\x04", 5) + "body";
  on_small_stack([&] {
    const auto arrived = from_bytes(bytes);
    ASSERT_TRUE(arrived);
    EXPECT_EQ(arrived->message.payload.text(), "body");
    EXPECT_EQ(arrived->message.properties.size(), 0U);
    EXPECT_FALSE(from_bytes(std::string(1'000'000, '\0'))) << "descriptors of descriptors";
    EXPECT_FALSE(from_bytes(std::string("\x00\x53\x77", 3) + nested)) << "a list is no body";
  });
}

TEST(ActiveMqMessage, TooManyPropertiesAreRefused) {
  std::string bytes;
  AmqpWriter writer(bytes);
  writer.descriptor(static_cast<std::uint8_t>(Section::application_properties));
  const std::size_t map = writer.begin_map();
  for (int i = 0; i < 100'000; ++i) {
    writer.text(std::to_string(i));
    writer.text("");
  }
  writer.end(map, 200'000);
  EXPECT_FALSE(from_bytes(bytes));
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

TEST(ActiveMqStatistics, TheQuestionIsReadByOthersAsItWasMeant) {
  const proton::message question = decoded(statistics_question("a,b", "temp-queue://answers", 7));
  EXPECT_EQ(question.to(),
            "queue://ActiveMQ.Statistics.Destinationa,bActiveMQ.Statistics.Destination.List.End.With.Null");
  EXPECT_EQ(question.reply_to(), "temp-queue://answers");
  EXPECT_EQ(proton::get<std::string>(question.correlation_id()), "7");
  EXPECT_FALSE(question.durable());
}

TEST(ActiveMqStatistics, AnAnswerSaysWhichQueueHasHowManyReadersAndMessages) {
  proton::message wire;
  wire.correlation_id(std::string("7"));
  wire.body() = std::map<std::string, proton::scalar>{
      {"destinationName", "queue://q"}, {"consumerCount", std::int64_t{2}}, {"size", std::int64_t{5}}};
  const StatisticsAnswer answer = statistics_answer(encoded(wire));
  EXPECT_EQ(answer.question, 7U);
  ASSERT_TRUE(answer.facts);
  EXPECT_EQ(answer.facts->name, "q");
  EXPECT_EQ(answer.facts->readers, 2U);
  EXPECT_EQ(answer.facts->messages, 5U);
}

TEST(ActiveMqStatistics, AnswersOfOthersAreNotTakenForOurs) {
  EXPECT_EQ(statistics_answer(encoded(proton::message())).question, 0U);
  proton::message odd;
  odd.correlation_id(std::string("7x"));
  odd.body() = std::map<std::string, proton::scalar>{{"destinationName", 5}, {"size", "many"}};
  EXPECT_EQ(statistics_answer(encoded(odd)).question, 7U);
  EXPECT_FALSE(statistics_answer(encoded(odd)).facts);
  EXPECT_THROW(statistics_answer("no AMQP"), MalformedAmqp);
}

}  // namespace
}  // namespace iotcloud::brokers::activemq
