// Properties of an AMQP message from a hostile or broken publisher: the client reads or refuses them and never crashes.
// (The fuzzers in tests/fuzz find what no author thought of.)
#include <cstdint>
#include <string>
#include <thread>

#include <amqp.h>
#include <amqp_framing.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/rabbitmq/wire/headers.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

std::string big_endian(std::uint64_t value, int bytes) {
  std::string text;
  for (int i = bytes - 1; i >= 0; --i) text.push_back(static_cast<char>(value >> (8 * i)));
  return text;
}

std::string entry(const std::string& name, char kind, const std::string& value) {
  return static_cast<char>(name.size()) + name + kind + value;
}

/// Properties with headers only, as on the wire.
std::string headers(const std::string& entries) {
  return std::string("\x20\0", 2) + big_endian(entries.size(), 4) + entries;
}

struct Read {
  bool understood = false;
  Message message;
};

Read read(std::string bytes) {
  amqp_pool_t pool;
  init_amqp_pool(&pool, 4096);
  void* decoded = nullptr;
  Read result;
  if (amqp_decode_properties(AMQP_BASIC_CLASS, &pool, {bytes.size(), bytes.data()}, &decoded) >= 0) {
    result.understood = true;
    decode_properties(*static_cast<const amqp_basic_properties_t*>(decoded), result.message);
  }
  empty_amqp_pool(&pool);
  return result;
}

TEST(HostileAmqpTest, EveryTypeOfFieldIsReadOrSkipped) {
  const std::string text = big_endian(2, 4) + "ab";
  const auto result =
      read(headers(entry("boolean", 't', "\1") + entry("i8", 'b', "\xff") + entry("u8", 'B', "\xff") +
                   entry("i16", 's', big_endian(0x8000, 2)) + entry("u16", 'u', big_endian(0xffff, 2)) +
                   entry("i32", 'I', big_endian(0x80000000, 4)) + entry("u32", 'i', big_endian(0xffffffff, 4)) +
                   entry("i64", 'l', big_endian(1ull << 63, 8)) + entry("stamp", 'T', big_endian(7, 8)) +
                   entry("f32", 'f', big_endian(0x7fc00000, 4)) + entry("f64", 'd', big_endian(0x7ff0000000000000, 8)) +
                   entry("decimal", 'D', "\2" + big_endian(314, 4)) + entry("text", 'S', text) +
                   entry("bytes", 'x', text) + entry("void", 'V', "") + entry("array", 'A', big_endian(3, 4) + "Vt\1") +
                   entry("table", 'F', big_endian(3, 4) + entry("k", 'V', ""))));
  ASSERT_TRUE(result.understood);
  const auto& properties = result.message.properties;
  const auto value = [&](const char* name) {
    const std::string* found = properties.find(name);
    return found == nullptr ? std::string("(none)") : *found;
  };
  EXPECT_EQ(value("boolean"), "true");
  EXPECT_EQ(value("i8"), "-1");
  EXPECT_EQ(value("u8"), "255");
  EXPECT_EQ(value("i16"), "-32768");
  EXPECT_EQ(value("u16"), "65535");
  EXPECT_EQ(value("i32"), "-2147483648");
  EXPECT_EQ(value("u32"), "4294967295");
  EXPECT_EQ(value("i64"), "-9223372036854775808");
  EXPECT_EQ(value("stamp"), "7");
  EXPECT_EQ(value("f32"), "nan");
  EXPECT_EQ(value("f64"), "inf");
  EXPECT_EQ(value("text"), "ab");
  EXPECT_EQ(value("bytes"), "ab");
  EXPECT_EQ(value("void"), "");
  for (const char* skipped : {"decimal", "array", "table"}) EXPECT_EQ(value(skipped), "(none)");
}

TEST(HostileAmqpTest, TheWordsOfTheWireMayHaveAnyType) {
  const auto result = read(headers(entry("sensorID", 'I', big_endian(5, 4)) + entry("siteID", 'V', "") +
                                   entry("time", 'F', big_endian(0, 4)) + entry("time", 'd', big_endian(1, 8)) +
                                   entry("x-iotcloud-resent", 'A', big_endian(0, 4))));
  ASSERT_TRUE(result.understood);
  EXPECT_EQ(result.message.driver_id, "5");
  EXPECT_EQ(result.message.gateway_id, "");
  EXPECT_EQ(result.message.time_ms, 0);
}

TEST(HostileAmqpTest, LengthsThatReachBeyondTheFrameAreRefused) {
  for (const std::uint64_t length : {1u, 7u, 0x7fffffffu, 0xffffffffu}) {
    EXPECT_FALSE(read(std::string("\x20\0", 2) + big_endian(length, 4)).understood) << length;
    EXPECT_FALSE(read(headers("\1aS" + big_endian(length, 4))).understood) << length;
    EXPECT_FALSE(read(headers("\1aF" + big_endian(length, 4))).understood) << length;
    EXPECT_FALSE(read(headers("\1aA" + big_endian(length, 4))).understood) << length;
  }
}

TEST(HostileAmqpTest, AFieldOfUnknownTypeIsRefused) {
  EXPECT_FALSE(read(headers(entry("a", '?', "12345678"))).understood);
}

TEST(HostileAmqpTest, PropertiesThatAreCutOffAnywhereAreRefused) {
  const std::string whole =
      headers(entry("sensorID", 'S', big_endian(4, 4) + "0a1b") + entry("n", 'I', std::string("\0\0\0\1", 4)));
  for (std::size_t size = 0; size < whole.size(); ++size) EXPECT_FALSE(read(whole.substr(0, size)).understood) << size;
}

TEST(HostileAmqpTest, AsManyHeadersAsAFrameHoldsAreRead) {
  std::string entries;
  for (int i = 0; i < 32'000; ++i) entries += entry("k", 'V', "");
  const auto result = read(headers(entries));
  ASSERT_TRUE(result.understood);
  EXPECT_EQ(result.message.properties.size(), 1u);
}

TEST(HostileAmqpTest, TablesNestedAsDeeplyAsAFrameAllowsAreReadOrRefused) {
  constexpr std::size_t largest_frame = 131'072;
  std::string table = big_endian(0, 4);
  while (table.size() + 9 < largest_frame) table = big_endian(table.size() + 3, 4) + "\1tF" + table;
  // On a thread, as frames are read, because the thread's stack is the limit.
  std::thread([&] { read(std::string("\x20\0", 2) + table); }).join();
}

}  // namespace
}  // namespace iotcloud::brokers::rabbitmq
