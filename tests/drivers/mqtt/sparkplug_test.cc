// What edge nodes of Sparkplug B say, without a broker.
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/drivers/mqtt/sparkplug/sparkplug.h>
#include <iotcloud/drivers/mqtt/sparkplug/sparkplug_driver.h>

namespace iotcloud::drivers::mqtt::sparkplug {
namespace {

using ::testing::HasSubstr;

Topic topic(Kind kind, const std::string& device = {}) {
  return {"plant", "edge", device, kind};
}

Metric metric(const std::string& name, Type type, Value value, std::optional<std::uint64_t> alias = {}) {
  Metric made;
  made.name = name;
  made.type = type;
  made.value = std::move(value);
  made.alias = alias;
  return made;
}

Payload birth(std::uint64_t session, std::uint64_t seq = 0) {
  Payload made;
  made.seq = seq;
  made.metrics = {metric("bdSeq", Type::int64, static_cast<std::int64_t>(session)),
                  metric("Speed", Type::int32, std::int64_t{5}, 3)};
  return made;
}

Payload data(std::uint64_t seq, std::optional<std::uint64_t> alias = 3) {
  Payload made;
  made.seq = seq;
  Metric one;
  one.alias = alias;
  one.value = std::uint64_t{0xffff'fffe};
  made.metrics.push_back(one);
  return made;
}

TEST(SparkplugTopics, are_read_strictly) {
  const auto read = parse_topic("spBv1.0/plant/DDATA/edge/sensor");
  ASSERT_TRUE(read);
  EXPECT_EQ(read->device, "sensor");
  EXPECT_EQ(read->text(), "spBv1.0/plant/DDATA/edge/sensor");
  for (const char* bad :
       {"spBv1.0/plant/DDATA/edge", "spBv1.0/plant/NDATA/edge/sensor", "spBv1.0/STATE/host", "spBv1.0//NDATA/edge",
        "spBv1.0/plant/XDATA/edge", "spAv1.0/plant/NDATA/edge", "spBv1.0/plant/DDATA/edge/a/b"})
    EXPECT_FALSE(parse_topic(bad)) << bad;
}

TEST(SparkplugPayloads, are_the_same_after_a_round_trip) {
  Payload made;
  made.timestamp_ms = 12;
  made.seq = 255;
  made.metrics = {metric("a", Type::int8, std::int64_t{-5}), metric("b", Type::uint64, std::uint64_t{1} << 63),
                  metric("c", Type::floating, 1.5F),         metric("d", Type::real, -2.25),
                  metric("e", Type::boolean, true, 9),       metric("f", Type::string, std::string("ä")),
                  metric("g", Type::int32, std::monostate())};
  const auto read = decode(encode(made));
  ASSERT_TRUE(read);
  EXPECT_EQ(read->seq, 255U);
  ASSERT_EQ(read->metrics.size(), made.metrics.size());
  for (std::size_t i = 0; i < made.metrics.size(); ++i) {
    EXPECT_EQ(read->metrics[i].name, made.metrics[i].name);
    EXPECT_EQ(read->metrics[i].value, made.metrics[i].value) << made.metrics[i].name;
  }
  EXPECT_EQ(read->metrics[4].alias, 9U);
  EXPECT_FALSE(decode("\xff\xff\xff"));
}

TEST(SparkplugNodes, complete_what_they_say_by_aliases) {
  Node node;
  auto first = birth(1);
  EXPECT_EQ(node.take(topic(Kind::node_birth), first), Node::Heard::in_order);
  auto next = data(1);
  EXPECT_EQ(node.take(topic(Kind::node_data), next), Node::Heard::in_order);
  EXPECT_EQ(next.metrics[0].name, "Speed");
  EXPECT_EQ(next.metrics[0].value, Value(std::int64_t{-2})) << "a signed one of 32 bits";
  auto unknown = data(2, 44);
  EXPECT_EQ(node.take(topic(Kind::node_data), unknown), Node::Heard::gap);
}

TEST(SparkplugNodes, notice_what_is_missing) {
  Node node;
  auto early = data(4);
  EXPECT_EQ(node.take(topic(Kind::node_data), early), Node::Heard::gap) << "no birth certificate";
  auto first = birth(1, 254);
  node.take(topic(Kind::node_birth), first);
  auto device = birth(1, 255);
  EXPECT_EQ(node.take(topic(Kind::device_birth, "sensor"), device), Node::Heard::in_order);
  auto next = data(0);
  EXPECT_EQ(node.take(topic(Kind::device_data, "sensor"), next), Node::Heard::in_order) << "after 255 comes 0";
  auto gap = data(2);
  EXPECT_EQ(node.take(topic(Kind::node_data), gap), Node::Heard::gap);
  auto after = data(3);
  EXPECT_EQ(node.take(topic(Kind::node_data), after), Node::Heard::in_order);
  node.lose_track();
  auto later = data(4);
  EXPECT_EQ(node.take(topic(Kind::node_data), later), Node::Heard::gap);
}

TEST(SparkplugNodes, die_of_their_own_session_only) {
  Node node;
  auto first = birth(2);
  node.take(topic(Kind::node_birth), first);
  Payload old = birth(1);
  EXPECT_EQ(node.take(topic(Kind::node_death), old), Node::Heard::stale) << "the last will of the session before";
  EXPECT_TRUE(node.is_alive());
  Payload death = birth(2);
  EXPECT_EQ(node.take(topic(Kind::node_death), death), Node::Heard::in_order);
  EXPECT_FALSE(node.is_alive());
  EXPECT_FALSE(node.is_alive(""));
}

TEST(SparkplugNodes, keep_no_more_than_a_bound_of_what_strangers_name) {
  Node node;
  auto first = birth(1);
  node.take(topic(Kind::node_birth), first);
  const std::size_t of_node = node.bytes();
  Payload large = birth(1, 1);
  large.metrics.push_back(metric(std::string(6 << 20, 'x'), Type::int8, std::int64_t{1}));
  EXPECT_EQ(node.take(topic(Kind::device_birth, "a"), large), Node::Heard::in_order);
  large.seq = 2;
  EXPECT_EQ(node.take(topic(Kind::device_birth, "b"), large), Node::Heard::too_much);
  EXPECT_FALSE(node.is_alive("b"));
  Payload death = birth(1, 3);
  EXPECT_EQ(node.take(topic(Kind::device_death, "a"), death), Node::Heard::in_order);
  EXPECT_EQ(node.bytes(), of_node);
  large.seq = 4;
  EXPECT_EQ(node.take(topic(Kind::device_birth, "b"), large), Node::Heard::in_order) << "there is room";
  Payload ended = birth(1);
  node.take(topic(Kind::node_death), ended);
  EXPECT_EQ(node.bytes(), 0U);
}

TEST(SparkplugValues, are_read_strictly) {
  EXPECT_EQ(value_of(Type::int8, "-128"), Value(std::int64_t{-128}));
  EXPECT_EQ(value_of(Type::uint64, "18446744073709551615"), Value(std::uint64_t{18446744073709551615U}));
  EXPECT_EQ(value_of(Type::real, "1.5"), Value(1.5));
  EXPECT_EQ(value_of(Type::boolean, "true"), Value(true));
  EXPECT_THROW(value_of(Type::int8, "128"), std::invalid_argument);
  EXPECT_THROW(value_of(Type::uint8, "-1"), std::invalid_argument);
  EXPECT_THROW(value_of(Type::int32, "1x"), std::invalid_argument);
  EXPECT_THROW(value_of(Type::boolean, "yes"), std::invalid_argument);
  EXPECT_THROW(value_of(Type::real, "nan"), std::invalid_argument);
  EXPECT_THROW(value_of(Type::structure, "{}"), std::invalid_argument);
}

TEST(SparkplugJson, has_names_types_and_values) {
  auto first = birth(1);
  first.metrics.push_back(metric("bad", Type::string, std::string("\xff")));
  const auto text = json_of(topic(Kind::device_birth, "sensor"), first);
  EXPECT_THAT(text, HasSubstr(R"("kind":"birth")"));
  EXPECT_THAT(text, HasSubstr(R"({"name":"Speed","type":"Int32","value":5})"));
  EXPECT_THAT(text, HasSubstr(R"("device":"sensor")"));
}

}  // namespace
}  // namespace iotcloud::drivers::mqtt::sparkplug
