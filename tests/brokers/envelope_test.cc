// The envelope of Kafka's records, compared with Thrift's generated code, and given hostile bytes.
#include "iotcloud/brokers/envelope.h"

#include <cstring>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>

#include "iotcloud/brokers/envelope_types.h"

namespace iotcloud::brokers {
namespace {

using apache::thrift::protocol::TBinaryProtocol;
using apache::thrift::transport::TMemoryBuffer;

std::string written_by_thrift(const envelope::TSensorMessage& message) {
  const auto buffer = std::make_shared<TMemoryBuffer>();
  TBinaryProtocol protocol(buffer);
  message.write(&protocol);
  return buffer->getBufferAsString();
}

std::string encoded(const Message& message) {
  const EnvelopeBytes bytes = encode_envelope(message);
  return {reinterpret_cast<const char*>(bytes.data.get()), bytes.size};
}

std::optional<OpenedEnvelope> open(const std::string& bytes) {
  return open_envelope(std::as_bytes(std::span(bytes.data(), bytes.size())));
}

std::string text(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

Message a_message() {
  Message message;
  message.driver_id = std::string("dri\0ver", 7);
  message.gateway_id = "gateway";
  message.time_ms = 1'700'000'000'123;
  message.payload = Payload::copy("the body");
  message.properties.set("a", "1");
  message.properties.set("b", std::string(300, 'v'));
  message.properties.set("zz", "");
  return message;
}

envelope::TSensorMessage the_same_for_thrift() {
  envelope::TSensorMessage same;
  same.__set_sensorId(std::string("dri\0ver", 7));
  same.__set_site("gateway");
  same.__set_body("the body");
  same.__set_properties({{"a", "1"}, {"b", std::string(300, 'v')}, {"time", "1700000000123"}, {"zz", ""}});
  return same;
}

// Builds bytes by hand.
std::string field(char type, int id) {
  return {type, static_cast<char>(id >> 8), static_cast<char>(id)};
}
std::string number(std::uint32_t value) {
  return {static_cast<char>(value >> 24U), static_cast<char>(value >> 16U), static_cast<char>(value >> 8U),
          static_cast<char>(value)};
}
std::string string(const std::string& value) {
  return number(static_cast<std::uint32_t>(value.size())) + value;
}
constexpr char string_type = 11;
constexpr char struct_type = 12;
constexpr char map_type = 13;
constexpr char list_type = 15;
const std::string stop(1, '\0');

TEST(Envelope, IsByteForByteWhatThriftWrites) {
  // Thrift's code sorts the map; this project's begins with the time and keeps the sender's order.
  Message only_time = a_message();
  only_time.properties = {};
  envelope::TSensorMessage same = the_same_for_thrift();
  same.__set_properties({{"time", "1700000000123"}});
  EXPECT_EQ(encoded(only_time), written_by_thrift(same));
  Message with_more = only_time;
  with_more.properties.set("u", "after t");
  with_more.properties.set("v", std::string(70'000, 'x'));
  same.__set_properties({{"time", "1700000000123"}, {"u", "after t"}, {"v", std::string(70'000, 'x')}});
  EXPECT_EQ(encoded(with_more), written_by_thrift(same));
}

TEST(Envelope, IsReadByThriftsOwnCode) {
  const std::string bytes = encoded(a_message());
  const auto buffer = std::make_shared<TMemoryBuffer>();
  buffer->write(reinterpret_cast<const std::uint8_t*>(bytes.data()), static_cast<std::uint32_t>(bytes.size()));
  TBinaryProtocol protocol(buffer);
  envelope::TSensorMessage read;
  EXPECT_EQ(read.read(&protocol), bytes.size());
  EXPECT_EQ(read, the_same_for_thrift());
}

TEST(Envelope, ReadsWhatThriftsOwnCodeWrote) {
  const std::string bytes = written_by_thrift(the_same_for_thrift());
  const auto opened = open(bytes);
  ASSERT_TRUE(opened);
  EXPECT_EQ(opened->message.driver_id, a_message().driver_id);
  EXPECT_EQ(opened->message.gateway_id, "gateway");
  EXPECT_EQ(opened->time_ms, 1'700'000'000'123);
  EXPECT_EQ(opened->message.properties, a_message().properties);
  EXPECT_EQ(text(opened->body), "the body");
}

TEST(Envelope, LeavesTheBodyWhereItIs) {
  const std::string bytes = encoded(a_message());
  const auto opened = open(bytes);
  ASSERT_TRUE(opened);
  EXPECT_EQ(reinterpret_cast<const char*>(opened->body.data()), bytes.data() + bytes.find("the body"));
}

TEST(Envelope, CarriesMuchMoreThanThriftsMessageLimitInAll) {
  Message message = a_message();
  message.payload = Payload::take(std::string(1'000'000, 'x'));
  for (int i = 0; i < 200; ++i) {
    const auto opened = open(encoded(message));
    ASSERT_TRUE(opened);
    ASSERT_EQ(opened->body.size(), 1'000'000U);
  }
}

TEST(Envelope, TheSendersTimeCannotBeReplacedByAProperty) {
  Message message = a_message();
  message.properties.set("time", "1");
  const auto opened = open(encoded(message));
  ASSERT_TRUE(opened);
  EXPECT_EQ(opened->time_ms, 1'700'000'000'123);
  EXPECT_EQ(opened->message.properties.find("time"), nullptr);
}

TEST(Envelope, ATimeThatIsNoNumberIsNone) {
  envelope::TSensorMessage odd = the_same_for_thrift();
  odd.__set_properties({{"time", "yesterday"}});
  const auto opened = open(written_by_thrift(odd));
  ASSERT_TRUE(opened);
  EXPECT_FALSE(opened->time_ms);
}

TEST(Envelope, UnknownFieldsOfEveryTypeAreSkipped) {
  std::string bytes;
  bytes += field(2, 100) + "\x01";
  bytes += field(3, 101) + "\x01";
  bytes += field(4, 102) + std::string(8, 'd');
  bytes += field(6, 103) + "ab";
  bytes += field(8, 104) + "abcd";
  bytes += field(10, 105) + "abcdefgh";
  bytes += field(string_type, 106) + string("more");
  bytes += field(struct_type, 107) + field(8, 1) + "abcd" + stop;
  bytes += field(map_type, 108) + std::string{8, string_type} + number(2) + "abcd" + string("x") + "efgh" + string("y");
  bytes += field(14, 109) + std::string{8} + number(1) + "abcd";
  bytes += field(list_type, 110) + std::string{string_type} + number(2) + string("x") + string("y");
  bytes += field(8, 1) + "abcd";  // the sensor's id, of another type
  bytes += field(string_type, 3) + string("body") + stop;
  const auto opened = open(bytes);
  ASSERT_TRUE(opened);
  EXPECT_EQ(text(opened->body), "body");
  EXPECT_EQ(opened->message.driver_id, "");
}

TEST(Envelope, WhatIsTruncatedIsRefusedAtEveryLength) {
  const std::string bytes = encoded(a_message());
  for (std::size_t size = 0; size < bytes.size(); ++size) EXPECT_FALSE(open(bytes.substr(0, size))) << size;
  EXPECT_TRUE(open(bytes));
}

TEST(Envelope, LengthsThatLieAreRefused) {
  for (const std::uint32_t length : {0x7fffffffU, 0x80000000U, 0xffffffffU, 100U}) {
    EXPECT_FALSE(open(field(string_type, 1) + number(length) + "short" + stop)) << length;
    EXPECT_FALSE(open(field(string_type, 3) + number(length) + "short" + stop)) << length;
    EXPECT_FALSE(open(field(map_type, 4) + std::string{string_type, string_type} + number(length) + stop)) << length;
    EXPECT_FALSE(open(field(list_type, 100) + std::string{string_type} + number(length) + stop)) << length;
    EXPECT_FALSE(open(field(map_type, 100) + std::string{2, 2} + number(length) + stop)) << length;
  }
}

TEST(Envelope, PropertiesThatAreNoStringsAreRefused) {
  EXPECT_FALSE(open(field(map_type, 4) + std::string{string_type, 8} + number(1) + string("key") + "abcd" + stop));
  EXPECT_TRUE(open(field(map_type, 4) + std::string{0, 0} + number(0) + stop)) << "an empty map has no types";
}

TEST(Envelope, TooManyPropertiesAreRefused) {
  std::string bytes = field(map_type, 4) + std::string{string_type, string_type} + number(10'000);
  for (int i = 0; i < 10'000; ++i) bytes += string(std::to_string(i)) + string("");
  EXPECT_FALSE(open(bytes + stop));
}

TEST(Envelope, NestingWithoutEndIsRefused) {
  std::string structs;
  for (int i = 0; i < 1'000'000; ++i) structs += field(struct_type, 100);
  EXPECT_FALSE(open(structs));
  std::string lists = field(list_type, 100);
  for (int i = 0; i < 1'000'000; ++i) lists += std::string{list_type} + number(1);
  EXPECT_FALSE(open(lists));
}

TEST(Envelope, UnknownTypesAreRefused) {
  for (const int type : {1, 5, 7, 9, 16, 17, 127, 255}) {
    EXPECT_FALSE(open(field(static_cast<char>(type), 100) + std::string(100, '\0'))) << type;
  }
}

TEST(Envelope, SurvivesBytesThatWereChangedAtRandom) {
  const std::string good = encoded(a_message());
  std::minstd_rand random(1);
  int refused = 0;
  for (int round = 0; round < 20'000; ++round) {
    std::string bytes = good;
    for (int changes = 0; changes < 3; ++changes) bytes[random() % bytes.size()] = static_cast<char>(random());
    const auto opened = open(bytes);
    refused += opened ? 0 : 1;
    if (opened && !opened->body.empty()) {
      EXPECT_GE(opened->body.data(), std::as_bytes(std::span(bytes)).data());
      EXPECT_LE(&opened->body.back(), &std::as_bytes(std::span(bytes)).back());
    }
  }
  EXPECT_GT(refused, 0);
}

}  // namespace
}  // namespace iotcloud::brokers
