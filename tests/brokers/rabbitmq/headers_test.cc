#include "iotcloud/brokers/rabbitmq/wire/headers.h"

#include <array>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "iotcloud/brokers/rabbitmq/resent_marks.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

amqp_bytes_t bytes(std::string& text) {
  return {text.size(), text.data()};
}

/// A header table as a server might send it, one entry for each call.
class Table {
 public:
  amqp_field_value_t& add(const std::string& name, std::uint8_t kind) {
    names_.push_back(std::make_unique<std::string>(name));
    amqp_table_entry_t entry{};
    entry.key = bytes(*names_.back());
    entry.value.kind = kind;
    entries_.push_back(entry);
    return entries_.back().value;
  }
  void add_text(const std::string& name, const std::string& value) {
    names_.push_back(std::make_unique<std::string>(value));
    std::string& kept = *names_.back();
    add(name, AMQP_FIELD_KIND_UTF8).value.bytes = bytes(kept);
  }
  Message decode(bool* resent = nullptr) {
    amqp_basic_properties_t properties{};
    properties._flags = AMQP_BASIC_HEADERS_FLAG;
    properties.headers = {static_cast<int>(entries_.size()), entries_.data()};
    Message message;
    const bool marked = decode_properties(properties, message);
    if (resent != nullptr) *resent = marked;
    return message;
  }

 private:
  std::vector<std::unique_ptr<std::string>> names_;
  std::vector<amqp_table_entry_t> entries_;
};

TEST(RabbitMqHeadersTest, ComeBackAsTheyWent) {
  Message sent;
  sent.driver_id = std::string("a\0b", 3);
  sent.gateway_id = "gateway";
  sent.time_ms = 1'700'000'000'123;
  sent.properties.set("k", "v");
  sent.properties.set("empty", "");
  MessageProperties properties;
  Message received;
  EXPECT_FALSE(decode_properties(properties.encode(sent, {}), received));
  EXPECT_EQ(received.driver_id, sent.driver_id);
  EXPECT_EQ(received.gateway_id, sent.gateway_id);
  EXPECT_EQ(received.time_ms, sent.time_ms);
  EXPECT_EQ(received.properties, sent.properties);
}

TEST(RabbitMqHeadersTest, AreNamedAsInTheOriginal) {
  Message sent;
  sent.driver_id = "id";
  sent.gateway_id = "site";
  sent.time_ms = 42;
  MessageProperties encoder;
  const amqp_basic_properties_t& properties = encoder.encode(sent, {});
  ASSERT_EQ(properties.headers.num_entries, 3);
  const std::array<std::pair<std::string, std::string>, 3> expected{
      {{"sensorID", "id"}, {"siteID", "site"}, {"time", "42"}}};
  for (int i = 0; i < 3; ++i) {
    const auto& entry = properties.headers.entries[i];
    EXPECT_EQ(std::string(static_cast<const char*>(entry.key.bytes), entry.key.len), expected[i].first);
    EXPECT_EQ(entry.value.kind, AMQP_FIELD_KIND_UTF8);
    EXPECT_EQ(std::string(static_cast<const char*>(entry.value.value.bytes.bytes), entry.value.value.bytes.len),
              expected[i].second);
  }
}

TEST(RabbitMqHeadersTest, CarryDurabilityExpiryOriginAndResentMark) {
  MessageProperties encoder;
  MessageProperties::SendOptions options;
  options.durable = true;
  options.resent = true;
  options.expires_in = std::chrono::milliseconds(250);
  options.origin = {0x00ab, 77};
  const amqp_basic_properties_t& properties = encoder.encode(Message{}, options);
  EXPECT_EQ(properties.delivery_mode, AMQP_DELIVERY_PERSISTENT);
  EXPECT_EQ(std::string(static_cast<const char*>(properties.expiration.bytes), properties.expiration.len), "250");
  EXPECT_EQ(std::string(static_cast<const char*>(properties.message_id.bytes), properties.message_id.len),
            "00000000000000ab-77");
  EXPECT_EQ(origin_of(properties), (MessageOrigin{0x00ab, 77}));
  Message received;
  EXPECT_TRUE(decode_properties(properties, received));
  EXPECT_TRUE(received.properties.empty()) << "the mark is ours, not the user's";
}

TEST(RabbitMqHeadersTest, CustomPropertiesCannotForgeTheMetadata) {
  Message sent;
  sent.driver_id = "real";
  sent.properties.set("sensorID", "forged");
  MessageProperties encoder;
  Message received;
  decode_properties(encoder.encode(sent, {}), received);
  EXPECT_EQ(received.driver_id, "real");
}

TEST(RabbitMqHeadersTest, OddTypesBecomeText) {
  Table table;
  table.add("time", AMQP_FIELD_KIND_I64).value.i64 = 1234;
  table.add("sensorID", AMQP_FIELD_KIND_I32).value.i32 = -5;
  table.add("yes", AMQP_FIELD_KIND_BOOLEAN).value.boolean = 1;
  table.add("byte", AMQP_FIELD_KIND_I8).value.i8 = -1;
  table.add("unsigned", AMQP_FIELD_KIND_U16).value.u16 = 65535;
  table.add("stamp", AMQP_FIELD_KIND_TIMESTAMP).value.u64 = 99;
  table.add("real", AMQP_FIELD_KIND_F64).value.f64 = 1.5;
  table.add("nothing", AMQP_FIELD_KIND_VOID);
  const Message message = table.decode();
  EXPECT_EQ(message.time_ms, 1234);
  EXPECT_EQ(message.driver_id, "-5");
  EXPECT_EQ(*message.properties.find("yes"), "true");
  EXPECT_EQ(*message.properties.find("byte"), "-1");
  EXPECT_EQ(*message.properties.find("unsigned"), "65535");
  EXPECT_EQ(*message.properties.find("stamp"), "99");
  EXPECT_EQ(*message.properties.find("real"), "1.5");
  EXPECT_EQ(*message.properties.find("nothing"), "");
}

TEST(RabbitMqHeadersTest, NestedAndUnknownTypesAreSkipped) {
  Table table;
  table.add("table", AMQP_FIELD_KIND_TABLE).value.table = amqp_empty_table;
  table.add("array", AMQP_FIELD_KIND_ARRAY).value.array = amqp_empty_array;
  table.add("decimal", AMQP_FIELD_KIND_DECIMAL).value.decimal = {2, 314};
  table.add("alien", '?');
  table.add("sensorID", AMQP_FIELD_KIND_TABLE).value.table = amqp_empty_table;
  table.add_text("kept", "v");
  const Message message = table.decode();
  EXPECT_EQ(message.driver_id, "");
  EXPECT_EQ(message.properties.size(), 1U);
  EXPECT_EQ(*message.properties.find("kept"), "v");
}

TEST(RabbitMqHeadersTest, ATimeThatIsNoNumberIsZero) {
  for (const std::string text : {"", "soon", "12x", "99999999999999999999999"}) {
    Table table;
    table.add_text("time", text);
    EXPECT_EQ(table.decode().time_ms, 0) << text;
  }
  Table negative;
  negative.add_text("time", "-7");
  EXPECT_EQ(negative.decode().time_ms, -7);
}

TEST(RabbitMqHeadersTest, NoHeadersAtAllAreFine) {
  amqp_basic_properties_t properties{};
  Message message;
  EXPECT_FALSE(decode_properties(properties, message));
  EXPECT_EQ(origin_of(properties), std::nullopt);
}

TEST(RabbitMqHeadersTest, TheLargestOriginFits) {
  constexpr auto largest = std::numeric_limits<std::uint64_t>::max();
  MessageProperties encoder;
  MessageProperties::SendOptions options;
  options.origin = {largest, largest};
  EXPECT_EQ(origin_of(encoder.encode(Message{}, options)), (MessageOrigin{largest, largest}));
}

TEST(RabbitMqHeadersTest, AMessageIdThatIsNotOursIsNoOrigin) {
  for (std::string id : {"", "77", "ID:host-1", "00000000000000ab", "00000000000000ab-", "00000000000000ab-x",
                         "00000000000000xb-1", "00000000000000ab-18446744073709551616"}) {
    amqp_basic_properties_t properties{};
    properties.message_id = {id.size(), id.data()};
    properties._flags = AMQP_BASIC_MESSAGE_ID_FLAG;
    EXPECT_EQ(origin_of(properties), std::nullopt) << id;
  }
}

TEST(ResentMarksTest, CopiesThatComeAfterAMarkedOneMayHaveBeenRead) {
  ResentMarks marks;
  const std::uint64_t one = 1;
  const std::uint64_t other = 2;
  EXPECT_FALSE(marks.may_be_a_copy(MessageOrigin{one, 5}, false));
  EXPECT_TRUE(marks.may_be_a_copy(MessageOrigin{one, 6}, true));
  EXPECT_TRUE(marks.may_be_a_copy(MessageOrigin{one, 7}, true));
  EXPECT_FALSE(marks.may_be_a_copy(MessageOrigin{one, 8}, false)) << "new";
  EXPECT_TRUE(marks.may_be_a_copy(MessageOrigin{one, 6}, false));
  EXPECT_TRUE(marks.may_be_a_copy(MessageOrigin{one, 7}, false));
  EXPECT_FALSE(marks.may_be_a_copy(MessageOrigin{other, 7}, false));
}

TEST(ResentMarksTest, WhatOthersPublishHasOnlyItsMark) {
  ResentMarks marks;
  EXPECT_TRUE(marks.may_be_a_copy(std::nullopt, true));
  EXPECT_FALSE(marks.may_be_a_copy(std::nullopt, false));
}

TEST(ResentMarksTest, ThePublisherOfNowIsNotForgottenForTheManyBefore) {
  ResentMarks marks;
  constexpr std::uint64_t many = 100'000;
  for (std::uint64_t publisher = many; publisher > 0; --publisher) {
    marks.may_be_a_copy(MessageOrigin{publisher, 3}, true);
    ASSERT_TRUE(marks.may_be_a_copy(MessageOrigin{publisher, 2}, false));
  }
  EXPECT_FALSE(marks.may_be_a_copy(MessageOrigin{2, 2}, false)) << "what is kept is bounded";
}

}  // namespace
}  // namespace iotcloud::brokers::rabbitmq
