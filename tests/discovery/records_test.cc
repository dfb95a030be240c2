// The bytes in the registry are read and written by programs of the original system: ids and types must not drift.
#include <random>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::discovery {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

/// Writes Thrift's binary protocol by hand: a field is its type, its id (two bytes, big endian) and its value.
class Bytes {
 public:
  Bytes& field(char type, int id) { return raw(std::string(1, type)).number(static_cast<std::uint64_t>(id), 2); }
  Bytes& string(int id, const std::string& text) { return field(11, id).text(text); }
  Bytes& i32(int id, std::uint32_t value) { return field(8, id).number(value, 4); }
  Bytes& i64(int id, std::uint64_t value) { return field(10, id).number(value, 8); }
  Bytes& boolean(int id, bool value) { return field(2, id).raw(std::string(1, value ? '\1' : '\0')); }
  Bytes& text(const std::string& value) { return number(value.size(), 4).raw(value); }
  Bytes& stop() { return raw(std::string(1, '\0')); }
  Bytes& number(std::uint64_t value, int width) {
    for (int shift = 8 * (width - 1); shift >= 0; shift -= 8) bytes_ += static_cast<char>(value >> shift);
    return *this;
  }
  Bytes& raw(const std::string& value) {
    bytes_ += value;
    return *this;
  }
  const std::string& str() const { return bytes_; }

 private:
  std::string bytes_;
};

ChannelRecord example_channel() {
  ChannelRecord record;
  record.name = "kinect";
  record.transport = "rabbitmq";
  record.direction = Direction::out;
  record.properties = {{"exchange", "g.turtle"}, {"queueName", "q"}};
  record.broker_url = "amqp://b";
  record.gateway = "gw"_gateway;
  record.driver = "turtle"_driver;
  record.instance = "0123"_instance;
  record.shared = true;
  return record;
}

std::string channel_bytes() {
  return Bytes()
      .string(1, "rabbitmq")
      .i32(2, 1)
      .field(13, 3)
      .raw("\x0b\x0b")
      .number(2, 4)
      .text("exchange")
      .text("g.turtle")
      .text("queueName")
      .text("q")
      .string(4, "amqp://b")
      .string(5, "kinect")
      .string(6, "gw")
      .string(7, "turtle")
      .boolean(8, true)
      .string(9, "0123")
      .stop()
      .str();
}

DriverRecord example_driver() {
  DriverRecord record;
  record.name = "turtle"_driver;
  record.instance = "0123"_instance;
  record.gateway = "gw"_gateway;
  record.state = DriverState::failed;
  record.reason = "no Kinect";
  record.since_ms = 0x0102030405060708;
  record.metadata = {{"room", "A 1"}};
  record.channels = {example_channel()};
  return record;
}

std::string driver_bytes(std::uint32_t state = 2, const std::string& exact = "failed") {
  return Bytes()
      .string(1, "turtle")
      .string(2, "gw")
      .i32(3, state)
      .string(4, R"({"room":"A 1"})")
      .field(15, 5)
      .raw("\x0c")
      .number(1, 4)
      .raw(channel_bytes())
      .string(6, "0123")
      .string(100, exact)
      .string(101, "no Kinect")
      .i64(102, 0x0102030405060708)
      .stop()
      .str();
}

TEST(Records, AChannelsBytesAreThoseOfTheOriginal) {
  EXPECT_EQ(encode(example_channel()), channel_bytes());
  EXPECT_EQ(decode_channel(channel_bytes(), "/c"), example_channel());
}

TEST(Records, ADriversBytesAreThoseOfTheOriginalWithOurFieldsFrom100Up) {
  EXPECT_EQ(encode(example_driver()), driver_bytes());
  EXPECT_EQ(decode_driver(driver_bytes(), "/d"), example_driver());
}

TEST(Records, ADriverThatIsStartedAgainByItselfSaysSoInAFieldThatOlderProgramsPassOver) {
  auto record = example_driver();
  record.starts_again = true;
  record.made_by = "rule meters";
  std::string expected = driver_bytes();
  expected.insert(expected.size() - 1, std::string("\x02\x00\x6c\x01", 4));  // field 108, a bool
  expected.insert(expected.size() - 1, Bytes().string(109, "rule meters").str());
  EXPECT_EQ(encode(record), expected);
  EXPECT_EQ(decode_driver(expected, "/d"), record);
}

TEST(Records, AGatewaysBytesAreThoseOfTheOriginalWithOurFieldsFrom100Up) {
  GatewayRecord record;
  record.id = "gw"_gateway;
  record.host = "robot.local";
  record.port = 12905;
  record.brokers = {"rabbitmq", "kafka"};
  record.since_ms = 7;
  const std::string no_properties = Bytes().field(13, 2).raw("\x0b\x0b").number(0, 4).stop().str();
  const std::string expected = Bytes()
                                   .string(1, "gw")
                                   .i32(2, 12905)
                                   .string(3, "robot.local")
                                   .field(15, 5)
                                   .raw("\x0c")
                                   .number(2, 4)
                                   .string(1, "rabbitmq")
                                   .raw(no_properties)
                                   .string(1, "kafka")
                                   .raw(no_properties)
                                   .i64(100, 7)
                                   .stop()
                                   .str();
  EXPECT_EQ(encode(record), expected);
  EXPECT_EQ(decode_gateway(expected, "/g"), record);
}

TEST(Records, AnInstanceOfTheOriginalThatSaysDeployIsActive) {
  const auto original = [](std::uint32_t state) {
    return decode_driver(Bytes().string(1, "s").i32(3, state).string(6, "id").stop().str(), "/d").state;
  };
  EXPECT_EQ(original(0), DriverState::active);
  EXPECT_EQ(original(1), DriverState::active);
  EXPECT_EQ(original(2), DriverState::inactive);
  EXPECT_EQ(original(3), DriverState::undeployed);
}

TEST(Records, EveryStateComesBackAndTheOriginalSeesDeployOnlyWhenChannelsCanBeRead) {
  for (const DriverState state :
       {DriverState::deployed, DriverState::starting, DriverState::active, DriverState::stopping, DriverState::inactive,
        DriverState::failed, DriverState::undeployed}) {
    DriverRecord record = example_driver();
    record.state = state;
    const std::string bytes = encode(record);
    EXPECT_EQ(decode_driver(bytes, "/d").state, state);
    EXPECT_EQ(parse_driver_state(to_string(state)), state);
    const bool says_deploy = bytes.find(Bytes().i32(3, 0).str()) != std::string::npos;
    EXPECT_EQ(says_deploy, state == DriverState::active) << to_string(state);
  }
  EXPECT_THROW(parse_driver_state("asleep"), config::Error);
}

TEST(Records, AStateOfANewerProgramFallsBackToTheNearestWord) {
  EXPECT_EQ(decode_driver(driver_bytes(0, "hibernating"), "/d").state, DriverState::active);
}

TEST(Records, FieldsOfANewerProgramArePassedOver) {
  std::string bytes = channel_bytes();
  bytes.pop_back();
  bytes += Bytes().string(200, "new").field(15, 201).raw("\x08").number(2, 4).number(1, 4).number(2, 4).stop().str();
  EXPECT_EQ(decode_channel(bytes, "/c"), example_channel());
}

TEST(Records, MetadataThatIsNotOursIsNoError) {
  const std::string bytes = Bytes().string(1, "s").string(4, std::string("\x00\xff java", 7)).stop().str();
  EXPECT_EQ(decode_driver(bytes, "/d").metadata.size(), 0U);
}

/// The message of the config::Error that decoding throws; empty when it throws none. Other exceptions are failures.
template <typename Decode>
std::string refusal(const Decode& decode, const std::string& bytes) {
  try {
    decode(bytes, "/iot/x");
  } catch (const config::Error& error) {
    return error.what();
  }
  return {};
}

TEST(Records, BytesThatAreCutOffAreRefusedAtEveryLength) {
  const std::string bytes = driver_bytes();
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_THAT(refusal(decode_driver, bytes.substr(0, size)), HasSubstr("/iot/x")) << size;
  }
  EXPECT_THAT(refusal(decode_driver, bytes + "x"), HasSubstr("too many"));
}

TEST(Records, AbsurdSizesAreRefusedWithoutMakingRoomForThem) {
  for (const std::uint32_t size : {0x7fffffffU, 0xffffffffU, 0x80000000U, 0x10000U}) {
    EXPECT_NE(refusal(decode_channel, Bytes().field(11, 1).number(size, 4).stop().str()), "") << size;
    EXPECT_NE(refusal(decode_channel, Bytes().field(13, 3).raw("\x0b\x0b").number(size, 4).stop().str()), "") << size;
    EXPECT_NE(refusal(decode_driver, Bytes().field(15, 5).raw("\x0c").number(size, 4).stop().str()), "") << size;
  }
}

TEST(Records, ADirectionThatIsNoneIsRefused) {
  for (const std::uint32_t direction : {2U, 7U, 0xffffffffU}) {
    EXPECT_THAT(refusal(decode_channel, Bytes().string(1, "t").i32(2, direction).stop().str()), HasSubstr("direction"));
  }
}

TEST(Records, RequiredFieldsOfAGatewayMustBeThere) {
  EXPECT_NE(refusal(decode_gateway, Bytes().string(1, "gw").i32(2, 1).stop().str()), "");
}

TEST(Records, RandomHarmIsEitherReadOrRefused) {
  std::mt19937 random(7);  // NOLINT: the same damage in every run
  const std::string good = driver_bytes();
  for (int round = 0; round < 2000; ++round) {
    std::string bytes = good;
    for (int i = 0; i < 1 + round % 4; ++i) bytes[random() % bytes.size()] = static_cast<char>(random());
    static_cast<void>(refusal(decode_driver, bytes));
    static_cast<void>(refusal(decode_channel, bytes));
    static_cast<void>(refusal(decode_gateway, bytes));
  }
}

TEST(Records, NestingWithoutEndIsRefused) {
  std::string bytes;
  for (int i = 0; i < 100000; ++i) bytes += Bytes().field(12, 50).str();
  EXPECT_NE(refusal(decode_channel, bytes), "");
}

TEST(Records, OrdersAndTopologiesAreJson) {
  OrderRecord order;
  order.instance = "0123"_instance;
  order.driver = "turtle"_driver;
  order.plugin = "turtle.so";
  order.active = false;
  order.properties = {{"rate", "30"}};
  order.metadata = {{"owner", "lab"}};
  order.epoch = 1234567890123;
  EXPECT_EQ(decode_order(encode(order), "/o"), order);
  EXPECT_THAT(encode(order), HasSubstr(R"("plugin":"turtle.so")"));
  TopologyRecord topology;
  topology.name = "follower"_topology;
  topology.since_ms = 5;
  topology.spouts = {"kinect"};
  topology.bolts = {"follow", "send"};
  EXPECT_EQ(decode_topology(encode(topology), "/t"), topology);
}

TEST(Records, WhichPluginAnInstanceRunsIsInItsOrderAndItsRecord) {
  OrderRecord order;
  order.instance = "0123"_instance;
  order.plugin = "turtle-2.so";
  EXPECT_THAT(encode(order), Not(HasSubstr("sha256"))) << "programs before know nothing of it";
  order.sha256 = std::string(64, '2');
  order.previous = PluginVersion{"turtle.so", std::string(64, '1')};
  EXPECT_EQ(decode_order(encode(order), "/o"), order);
  EXPECT_EQ(order.version(), (PluginVersion{"turtle-2.so", std::string(64, '2')}));
  EXPECT_THAT(refusal(decode_order, R"({"instance":"1","plugin":"p","previous":{"sha256":""}})"),
              HasSubstr("\"plugin\" is missing"));
  DriverRecord record = example_driver();
  record.plugin = "turtle-2.so";
  record.sha256 = order.sha256;
  record.signed_by = "lab";
  EXPECT_EQ(decode_driver(encode(record), "/d").sha256, order.sha256);
  EXPECT_EQ(decode_driver(encode(record), "/d").plugin, "turtle-2.so");
  EXPECT_EQ(decode_driver(encode(record), "/d").signed_by, "lab");
}

TEST(Records, OrdersToTopologiesAndWhatWorkersSayAreJson) {
  TopologyOrder order;
  order.revision = 7;
  order.epoch = 9;
  order.active = false;
  order.parallelism = {{"decode", 3}};
  EXPECT_EQ(decode_topology_order(encode(order), "/o"), order);
  order.kill = {{"w1", "w2"}, 500, 1234567890123};
  EXPECT_EQ(decode_topology_order(encode(order), "/o"), order);
  EXPECT_THAT(refusal(decode_topology_order, R"({"active":true})"), HasSubstr("\"revision\" is missing"));
  EXPECT_THAT(refusal(decode_topology_order, R"({"revision":1,"kill":{"drain_ms":1}})"),
              HasSubstr("\"workers\" is missing"));
  EXPECT_THAT(refusal(decode_topology_order, R"({"revision":1,"kill":true})"), HasSubstr("object"));

  WorkerRecord worker;
  worker.name = "w1";
  worker.host = "h";
  worker.pid = 42;
  worker.http = "127.0.0.1:1234";
  worker.state = "inactive";
  worker.revision = 7;
  worker.error = "no";
  worker.since_ms = 5;
  worker.components = {{"decode", {3, 4}}};
  EXPECT_THAT(encode(worker), Not(HasSubstr("tls")));  // older readers see what they know
  EXPECT_EQ(decode_worker(encode(worker), "/w"), worker);
  worker.tls = true;
  EXPECT_EQ(decode_worker(encode(worker), "/w"), worker);
  EXPECT_FALSE(decode_worker(R"({"name":"w","http":"127.0.0.1:1234"})", "/w").tls);
  EXPECT_THAT(refusal(decode_worker, R"({"name":"w","components":{"decode":{"tasks":1}}})"),
              AllOf(HasSubstr("decode"), HasSubstr("\"parallelism\" is missing")));
}

TEST(Records, JsonThatIsNoOrderIsRefusedWithItsKey) {
  EXPECT_THAT(refusal(decode_order, "{"), HasSubstr("/iot/x: not an order"));
  EXPECT_THAT(refusal(decode_order, "[]"), HasSubstr("object"));
  EXPECT_THAT(refusal(decode_order, R"({"instance":"1"})"), HasSubstr("\"plugin\" is missing"));
  EXPECT_THAT(refusal(decode_order, R"({"instance":1,"plugin":"p"})"), HasSubstr("\"instance\""));
  EXPECT_THAT(refusal(decode_order, R"({"instance":"1","plugin":"p","active":"yes"})"), HasSubstr("\"active\""));
  EXPECT_EQ(refusal(decode_order, R"({"instance":"1","plugin":"p","new":[1,2]})"), "");
  EXPECT_NE(refusal(decode_topology, std::string(100000, '[')), "");
  OrderRecord no_utf8;
  no_utf8.instance = "\xff"_instance;
  no_utf8.plugin = "p";
  EXPECT_EQ(decode_order(encode(no_utf8), "/o").plugin, "p");
}

TEST(Records, PathsFollowTheSensorsRoot) {
  const Paths paths;
  EXPECT_EQ(paths.channel("turtle"_driver, "01"_instance, "kinect"), "/iot/sensors/turtle/01/kinect");
  EXPECT_EQ(paths.order("gw"_gateway, "01"_instance), "/iot/gateways/gw/orders/01");
  EXPECT_EQ(paths.gateway_alive("gw"_gateway), "/iot/gateways/gw/alive");
  EXPECT_EQ(paths.masters(), "/iot/masters");
  EXPECT_EQ(paths.workers("t"_topology), "/iot/topologies/t/workers");
  EXPECT_EQ(Paths("/sensors").gateway("gw"_gateway), "/gateways/gw");
  EXPECT_EQ(Paths("/a/b/c").topology("t"_topology), "/a/b/topologies/t");
}

TEST(Records, ANameCannotReachAnotherPlace) {
  const Paths paths;
  for (const std::string& name : {std::string(), std::string("."), std::string(".."), std::string("a/b"),
                                  std::string("/"), std::string("a\0b", 3)}) {
    EXPECT_THROW(paths.driver(DriverName(name)), config::Error);
    EXPECT_THROW(paths.order("gw"_gateway, InstanceId(name)), config::Error);
  }
  for (const std::string root : {"", "/", "iot/sensors", "/iot/sensors/", "/iot//sensors", "/iot/gateways"}) {
    EXPECT_THROW(Paths{root}, config::Error) << root;
  }
}

TEST(Records, InstanceIdsAreUuidsWithoutDashesAndDiffer) {
  const std::string id = new_instance_id().str();
  EXPECT_THAT(id, testing::MatchesRegex("[0-9a-f]+"));
  EXPECT_EQ(id.size(), 32U);
  EXPECT_EQ(id[12], '4');
  EXPECT_NE(id, new_instance_id());
}

}  // namespace
}  // namespace iotcloud::discovery
