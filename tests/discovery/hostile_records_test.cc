// What anybody who may write to the registry can put into a node: JSON of any depth, size and type.
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/presence.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {
namespace {

using testing::AllOf;
using testing::HasSubstr;

/// The message of the config::Error that decoding throws; empty when it throws none. Other exceptions are failures.
template <typename Decode>
std::string refused(const Decode& decode, const std::string& bytes) {
  try {
    decode(bytes, "/iot/x");
  } catch (const config::Error& error) {
    return error.what();
  }
  return {};
}

/// `object` with a key whose value is lists within lists. It is good JSON, which a reader that only passes unknown keys
/// over would take.
std::string deep(const std::string& object, int levels) {
  const auto nested =
      std::string(static_cast<std::size_t>(levels), '[') + std::string(static_cast<std::size_t>(levels), ']');
  return object.substr(0, object.size() - 1) + (object == "{}" ? "" : ",") + R"("new":)" + nested + "}";
}

TEST(HostileRecords, NestingThatWouldOverflowTheStackIsRefused) {
  constexpr int levels = 100'000;  // 200 KB
  const auto too_deep = AllOf(HasSubstr("/iot/x"), HasSubstr("levels"));
  EXPECT_THAT(refused(decode_order, deep(R"({"instance":"1","plugin":"p"})", levels)), too_deep);
  EXPECT_THAT(refused(decode_removal, deep(R"({"instance":"1","given_ms":1})", levels)), too_deep);
  EXPECT_THAT(refused(decode_drain, deep("{}", levels)), too_deep);
  EXPECT_THAT(refused(decode_topology, deep(R"({"name":"t"})", levels)), too_deep);
  EXPECT_THAT(refused(decode_topology_order, deep(R"({"revision":1})", levels)), too_deep);
  EXPECT_THAT(refused(decode_worker, deep(R"({"name":"w"})", levels)), too_deep);
  EXPECT_THAT(refused(decode_life, deep("{}", levels)), too_deep);
  EXPECT_THAT(refused(decode_reader, deep("{}", levels)), too_deep);
  EXPECT_EQ(refused(decode_order, deep(R"({"instance":"1","plugin":"p"})", 10)), "") << "a newer program may say more";
}

TEST(HostileRecords, NestingInADriversMetadataIsNoErrorAndNoHarm) {
  DriverRecord record;
  record.name = DriverName("turtle");
  record.instance = InstanceId("1");
  std::string bytes = encode(record);
  const std::string empty_object("\0\0\0\2{}", 6);
  const auto place = bytes.find(empty_object);
  ASSERT_NE(place, std::string::npos);
  const std::string metadata = deep("{}", 100'000);
  std::string size;
  for (int shift = 24; shift >= 0; shift -= 8) size += static_cast<char>(metadata.size() >> shift);
  bytes.replace(place, empty_object.size(), size + metadata);
  EXPECT_TRUE(decode_driver(bytes, "/d").metadata.empty());
}

TEST(HostileRecords, MoreBytesThanANodeTakesAreRefused) {
  const std::string padding(max_node_size, ' ');
  EXPECT_THAT(refused(decode_order, R"({"instance":"1","plugin":"p"})" + padding), HasSubstr("bytes"));
}

TEST(HostileRecords, NumbersAreWholeAndFitWhereTheyAreKept) {
  const auto order = [](const std::string& field) { return R"({"instance":"1","plugin":"p",)" + field + "}"; };
  for (const std::string number :
       {"1e300", "-1e300", "2.5", "4294967297", "18446744073709551615", "true", "\"1\"", "null"}) {
    EXPECT_THAT(refused(decode_order, order(R"("index":)" + number)), AllOf(HasSubstr("/iot/x"), HasSubstr("index")))
        << number;
  }
  for (const std::string number : {"1e300", "9223372036854775808", "false", "[]"}) {
    EXPECT_THAT(refused(decode_order, order(R"("epoch":)" + number)), HasSubstr("epoch")) << number;
  }
  EXPECT_EQ(refused(decode_order, order(R"("epoch":9223372036854775807,"index":-2147483648)")), "");
  EXPECT_THAT(refused(decode_topology_order, R"({"revision":1,"parallelism":{"decode":1e300}})"),
              HasSubstr("parallelism"));
  EXPECT_THAT(refused(decode_topology_order, R"({"revision":1,"parallelism":[["decode",1]]})"),
              HasSubstr("parallelism"));
  EXPECT_THAT(refused(decode_order, order(R"("properties":{"rate":30})")), HasSubstr("properties"));
}

TEST(HostileRecords, WhatAGatewaySaysOfItselfHasTypes) {
  EXPECT_THAT(refused(decode_life, R"({"host":5})"), AllOf(HasSubstr("/iot/x"), HasSubstr("host")));
  EXPECT_THAT(refused(decode_life, R"({"port":"x"})"), HasSubstr("port"));
  EXPECT_THAT(refused(decode_life, "["), HasSubstr("/iot/x"));
  GatewayLife life;
  life.host = "lab1";
  life.port = 12905;
  life.pid = 7;
  life.state = "s";
  life.run = "r";
  EXPECT_EQ(decode_life(encode(life), "/l"), life);
  EXPECT_EQ(decode_life(R"({"host":"lab1","port":1,"pid":2,"state":"s"})", "/l").run, "") << "as older gateways say it";
}

TEST(HostileRecords, WhatAReaderSaysOfItselfHasTypes) {
  ReaderRecord reader;
  reader.topology = TopologyName("t");
  reader.tasks = 3;
  reader.shares = true;
  reader.broker = "rabbitmq";
  reader.where = "x == 1";
  reader.since_ms = 5;
  reader.engine = engine_storm;
  EXPECT_EQ(decode_reader(encode(reader), "/r"), reader);
  const std::string older = R"({"topology":"t","shares":false,"broker":"b","where":"","since":1,"tasks":1})";
  EXPECT_EQ(decode_reader(older, "/r").engine, "") << "as older workers say it";
  EXPECT_THAT(refused(decode_reader, R"({"tasks":1})"), HasSubstr("is missing"));
  for (const std::string tasks : {"0", "-1", "1000001", "1e9"}) {
    const std::string bytes =
        R"({"topology":"t","shares":false,"broker":"b","where":"","since":1,"tasks":)" + tasks + "}";
    EXPECT_THAT(refused(decode_reader, bytes), HasSubstr("tasks")) << tasks;
  }
}

}  // namespace
}  // namespace iotcloud::discovery
