#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/definition/definition_texts.h>
#include <iotcloud/topology/definition/definition.h>

namespace iotcloud::topology {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::StartsWith;
using texts::good_spout;
using texts::paper_example;
using texts::with_bolt;
using texts::with_spout;

/// The message of the error that reading `text` throws; empty when it throws none.
std::string error_of(const std::string& text) {
  try {
    static_cast<void>(TopologyDefinition::parse(text, "t.yaml"));
  } catch (const config::ConfigError& e) {
    return e.what();
  }
  return "";
}

TEST(TopologyDefinition, NamesTheErrorsOfAllComponentsAndSectionsAtOnce) {
  const std::string text = with_spout(good_spout + "    prefech: 3\n") +
                           "bolts:\n  b: {class: x, inputs: {from: s, deadline: 5}}\n  c: {class: x, parallelism: no}\n"
                           "runtime: {message_timeout: 30}\nmetrisc: {}\n";
  std::vector<std::string> lines;
  std::istringstream errors(error_of(text));
  for (std::string line; std::getline(errors, line);) lines.push_back(line);
  EXPECT_THAT(
      lines, testing::UnorderedElementsAre(
                 StartsWith("t.yaml:9:5: spouts.s.prefech: unknown key"),
                 AllOf(HasSubstr("bolts.b.inputs.deadline"), HasSubstr("is not a duration; write a number and a unit")),
                 HasSubstr("bolts.c.parallelism: \"no\" does not fit"),
                 AllOf(HasSubstr("runtime.message_timeout"), HasSubstr("\"30\" is not a duration")),
                 AllOf(HasSubstr("metrisc: unknown key"), HasSubstr("did you mean \"metrics\"?"))));
}

TEST(TopologyDefinition, ReadsThePapersExampleWordForWord) {
  const auto definition = TopologyDefinition::parse(paper_example, "paper.yaml");

  EXPECT_EQ(definition.name, "wordcount");
  EXPECT_EQ(definition.registry.url, "zookeeper://server1:2181");
  EXPECT_EQ(definition.zk_root, "/iot/sensors");
  ASSERT_THAT(definition.spouts, SizeIs(1));
  const auto& spout = definition.spouts[0];
  EXPECT_EQ(spout.id, "kinect_receive");
  ASSERT_TRUE(spout.endpoint);
  EXPECT_EQ(spout.endpoint->broker, "rabbitmq");
  EXPECT_EQ(spout.endpoint->driver, "turtle");
  EXPECT_EQ(spout.endpoint->channel, "kinect");
  EXPECT_EQ(spout.endpoint->fields, Fields({"frame", "driverID", "time"}));
  EXPECT_THAT(spout.endpoint->roles, ElementsAre(FieldRole::payload, FieldRole::driver_id, FieldRole::time));
  EXPECT_FALSE(spout.endpoint->reading.automatic_ack);
  ASSERT_THAT(definition.bolts, SizeIs(1));
  EXPECT_EQ(definition.bolts[0].id, "count_send");
  EXPECT_THAT(definition.bolts[0].inputs, IsEmpty());
}

TEST(TopologyDefinition, TakesTheOlderWordsSensorAndSensorID) {
  const auto definition = TopologyDefinition::parse(
      with_spout("    broker: rabbitmq\n    sensor: d\n    channel: c\n    fields: [sensorID, f]\n"), "t.yaml");
  EXPECT_EQ(definition.spouts.at(0).endpoint->driver, "d");
  EXPECT_THAT(definition.spouts.at(0).endpoint->roles, ElementsAre(FieldRole::driver_id, FieldRole::payload));
}

TEST(TopologyDefinition, ReadsFieldsThatAreMetadataAndProperties) {
  const auto definition = TopologyDefinition::parse(
      with_spout(
          "    broker: rabbitmq\n    driver: d\n    channel: c\n    builder: json\n"
          "    fields: [a, gatewayID, channel, redelivered, {property: battery}, {property: x y, as: other}, b]\n"),
      "t.yaml");
  const EndpointDefinition& endpoint = *definition.spouts.at(0).endpoint;
  EXPECT_EQ(endpoint.form, PayloadForm::built);
  EXPECT_EQ(endpoint.fields, Fields({"a", "gatewayID", "channel", "redelivered", "battery", "other", "b"}));
  EXPECT_THAT(endpoint.roles,
              ElementsAre(FieldRole::payload, FieldRole::gateway_id, FieldRole::channel, FieldRole::redelivered,
                          FieldRole::property, FieldRole::property, FieldRole::payload));
  EXPECT_THAT(endpoint.properties, ElementsAre("", "", "", "", "battery", "x y", ""));
  EXPECT_EQ(payload_fields(endpoint), Fields({"a", "b"}));
}

TEST(TopologyDefinition, RefusesFieldsThatCannotBe) {
  const auto spout = [](const std::string& fields) {
    return error_of(with_spout("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: " + fields + "\n"));
  };
  EXPECT_THAT(spout("[a, {property: sensorID}]"), HasSubstr("use the field driverID"));
  EXPECT_THAT(spout("[a, {property: x-iotcloud-resent}]"), HasSubstr("the system's own"));
  EXPECT_THAT(spout("[a, {property: b, as: time}]"), HasSubstr("another meaning"));
  EXPECT_THAT(spout("[a, {property: a}]"), HasSubstr("named twice"));
  EXPECT_THAT(spout("[a, {propertty: b}]"), HasSubstr("property"));
  EXPECT_THAT(spout("[a, b]"), HasSubstr("second field of the same meaning"));
  EXPECT_THAT(spout("[{property: b}, channel]"), HasSubstr("no field takes the message's payload"));
  EXPECT_THAT(error_of(with_bolt(
                  "    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f, driverID, gatewayID]\n")),
              HasSubstr("a bolt does not send \"gatewayID\""));
}

TEST(TopologyDefinition, RefusesAConfThatNothingReads) {
  EXPECT_THAT(error_of(with_spout(good_spout + "    conf: {prefetchCount: 500}\n")),
              AllOf(HasSubstr("t.yaml:9:"), HasSubstr("spouts.s.conf"), HasSubstr("\"properties\"")));
  EXPECT_THAT(error_of(with_bolt("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f, driverID]\n"
                                 "    conf: {capacity: 5}\n    inputs: {from: s}\n")),
              HasSubstr("bolts.b.conf"));
}

TEST(TopologyDefinition, RefusesAPlacementThatIsNone) {
  const std::string text = with_spout(good_spout);
  EXPECT_THAT(error_of(text + "runtime: {placement: {cores: [0, one]}}\n"),
              AllOf(HasSubstr("runtime.placement.cores"), HasSubstr("\"one\" is no core")));
  EXPECT_THAT(error_of(text + "runtime: {placement: {cores: [-1]}}\n"), HasSubstr("\"-1\" is no core"));
  EXPECT_THAT(error_of(text + "runtime: {placement: {priority: 100}}\n"), HasSubstr("runtime.placement.priority"));
  EXPECT_THAT(error_of(text + "runtime: {placement: {prio: 1}}\n"), HasSubstr("runtime.placement.prio: unknown key"));
}

TEST(TopologyDefinition, ReadsEverythingElse) {
  const auto definition = TopologyDefinition::parse(R"(
registry: "embedded://here"
topology.name: t
topology.library: [a.so, b.so]
brokers: {lab: "amqp://lab"}
conf: {colour: red}
runtime: {threads: 3, message_timeout: 5s, acking: false, max_spout_pending: 7, mailbox_capacity: 9,
          placement: {cores: [2, 3], priority: 10, lock_memory: true}}
metrics: {address: "127.0.0.1:9100"}
spouts:
  s:
    broker: lab
    driver: d
    channel: c
    fields: [f]
    builder: text
    stream: lines
    parallelism: 4
    tasks: 6
    max_spout_pending: 0
    properties: {ackMode: manual, prefetchCount: 17, requeue: false, maxTries: 5, keepLast: 1, deadLetter: lost}
bolts:
  inner:
    class: some.Class
    conf: {size: 12}
    parallelism: 2
    tasks: 8
    tick: 250ms
    deadline: 50ms
    late_stream: late
    scope: worker
    inputs:
      - {from: s, stream: lines, grouping: fields, fields: [f], deadline: 10ms, keep_last: 2, keep_key: [f]}
      - {from: s, stream: lines, grouping: custom, class: my.Grouping}
      - {from: s, stream: lines, grouping: direct, keep_last: 1}
  out:
    broker: lab
    driver: d
    channel: back
    fields: [f, driverID]
    properties: {whenFull: keep_newest, capacity: 1, deadline: 100ms, unknownDriver: fail}
    inputs: {from: inner}
)",
                                                    "t.yaml");
  EXPECT_EQ(definition.registry.url, "embedded://here");
  EXPECT_THAT(definition.libraries, ElementsAre("a.so", "b.so"));
  EXPECT_EQ(definition.brokers.at("lab").urls, std::vector<std::string>{"amqp://lab"});
  EXPECT_EQ(definition.conf.at("colour"), "red");
  EXPECT_EQ(definition.runtime.threads, 3);
  EXPECT_EQ(definition.runtime.message_timeout, std::chrono::seconds(5));
  EXPECT_FALSE(definition.runtime.acking);
  EXPECT_EQ(definition.runtime.max_spout_pending, 7);
  EXPECT_EQ(definition.runtime.mailbox_capacity, 9);
  EXPECT_THAT(definition.runtime.placement.cores, ElementsAre(2, 3));
  EXPECT_EQ(definition.runtime.placement.priority, 10);
  EXPECT_TRUE(definition.runtime.placement.lock_memory);
  EXPECT_EQ(definition.pages.address, "127.0.0.1:9100");
  const auto& spout = definition.spouts.at(0);
  EXPECT_EQ(spout.parallelism, 4);
  EXPECT_EQ(spout.tasks, 6);
  EXPECT_EQ(spout.max_spout_pending, 0U);
  EXPECT_EQ(definition.bolts.at(0).conf.at("size"), "12");
  EXPECT_EQ(spout.endpoint->stream, "lines");
  EXPECT_EQ(spout.endpoint->form, PayloadForm::text);
  EXPECT_FALSE(spout.endpoint->reading.automatic_ack);
  EXPECT_EQ(spout.endpoint->reading.dead_letter, "lost");
  EXPECT_EQ(spout.endpoint->reading.prefetch, 17);
  EXPECT_FALSE(spout.endpoint->reading.requeue);
  EXPECT_EQ(spout.endpoint->reading.max_tries, 5);
  EXPECT_EQ(spout.endpoint->reading.keep_last, 1);
  const auto& inner = definition.bolts.at(0);
  EXPECT_EQ(inner.class_name, "some.Class");
  EXPECT_EQ(inner.tick, std::chrono::milliseconds(250));
  EXPECT_EQ(inner.inputs.at(0).stream, "lines");
  EXPECT_EQ(inner.inputs.at(0).fields, Fields({"f"}));
  EXPECT_EQ(inner.inputs.at(0).deadline, std::chrono::milliseconds(10));
  EXPECT_EQ(inner.inputs.at(0).keep_last, 2U);
  EXPECT_EQ(inner.inputs.at(0).keep_key, Fields({"f"}));
  EXPECT_EQ(inner.inputs.at(1).grouping, "custom");
  EXPECT_EQ(inner.inputs.at(1).grouping_class, "my.Grouping");
  EXPECT_EQ(inner.inputs.at(2).grouping, "direct");
  EXPECT_EQ(inner.inputs.at(2).keep_last, 1U);
  EXPECT_THAT(inner.inputs.at(2).keep_key, IsEmpty());
  EXPECT_EQ(inner.parallelism, 2);
  EXPECT_EQ(inner.tasks, 8);
  EXPECT_EQ(inner.deadline, std::chrono::milliseconds(50));
  EXPECT_EQ(inner.late_stream, "late");
  EXPECT_TRUE(inner.worker_scope);
  const auto& out = definition.bolts.at(1);
  EXPECT_TRUE(out.endpoint->sending.keep_newest);
  EXPECT_EQ(out.endpoint->sending.capacity, 1);
  EXPECT_EQ(out.endpoint->sending.deadline, std::chrono::milliseconds(100));
  EXPECT_EQ(out.endpoint->sending.unknown_driver, UnknownDriver::fail);
  EXPECT_EQ(out.endpoint->sending.ack_when, AckWhen::accepted);
  EXPECT_EQ(out.inputs.at(0).grouping, "shuffle");
}

TEST(TopologyDefinition, TakesCredentialsOnlyWithTheAddressesThatTheyAreFor) {
  const auto with_broker = [](const std::string& options) {
    return with_spout(good_spout) + "brokers:\n  rabbitmq: {" + options + "}\n";
  };
  for (const std::string credentials : {"user: robot", "password_variable: P", "tls: {ca: /dev/null}"}) {
    EXPECT_THAT(error_of(with_broker(credentials)), AllOf(StartsWith("t.yaml:10:"), HasSubstr("urls")));
    EXPECT_EQ(error_of(with_broker(credentials + ", urls: [\"amqps://broker/\"]")), "");
  }
  EXPECT_EQ(error_of(with_broker("heartbeat: 1s")), "") << "where to connect may be left to the records";
}

TEST(TopologyDefinition, OfAFleetWhoseProcessesHaveUsersGoesToAddressesOfItsOwnFileOnly) {
  const std::string text =
      with_bolt(
          "    broker: rabbitmq\n    driver: d\n    channel: e\n    fields: [f, driverID]\n    inputs: {from: s}\n") +
      "  inner: {class: some.Class, inputs: {from: s}}\n"
      "registry.user: workers\nregistry.password_file: /etc/p\nregistry.users: /etc/users\n";
  const auto error_with = [&](const std::string& brokers) -> std::string {
    try {
      config::YamlSection::read_text(text + brokers, "t.yaml", [](config::YamlSection& top) {
        top.is_for_another_machine();
        static_cast<void>(TopologyDefinition::read(top, "t.yaml"));
      });
    } catch (const config::ConfigError& e) {
      return e.what();
    }
    return "";
  };
  for (const std::string brokers : {"", "brokers: {rabbitmq: \"\"}\n", "brokers: {rabbitmq: {heartbeat: 1s}}\n",
                                    "brokers: {lab: \"amqps://b/\"}\n"}) {
    std::vector<std::string> lines;
    std::istringstream errors(error_with(brokers));
    for (std::string line; std::getline(errors, line);) lines.push_back(line);
    const auto says = AllOf(HasSubstr("whatever address a channel's record names"),
                            HasSubstr("\"brokers: {rabbitmq: {urls: [...]}}\""));
    EXPECT_THAT(lines, ElementsAre(AllOf(StartsWith("t.yaml:5:5: spouts.s.broker: \"rabbitmq\""), says),
                                   AllOf(StartsWith("t.yaml:11:5: bolts.b.broker: \"rabbitmq\""), says)))
        << brokers;
  }
  EXPECT_EQ(error_with("brokers: {rabbitmq: \"amqps://b/\"}\n"), "");
  EXPECT_EQ(error_with("brokers: {rabbitmq: {urls: [\"amqps://b/\"]}}\n"), "");
}

TEST(TopologyDefinition, ReadsAutomaticAcknowledgement) {
  const auto definition =
      TopologyDefinition::parse(with_spout(good_spout + "    properties: {ackMode: auto}\n"), "t.yaml");
  EXPECT_TRUE(definition.spouts.at(0).endpoint->reading.automatic_ack);
}

TEST(TopologyDefinition, ReadsTheGroupThatASpoutSharesItsMessagesWith) {
  const auto definition = TopologyDefinition::parse(with_spout(good_spout + "    group: lab\n"), "t.yaml");
  EXPECT_EQ(definition.spouts.at(0).endpoint->group, "lab");
  EXPECT_THAT(error_of(with_spout(good_spout + "    group: a/b\n")),
              AllOf(StartsWith("t.yaml:9:"), HasSubstr("group")));
  EXPECT_THAT(error_of(with_bolt("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f, driverID]\n"
                                 "    group: lab\n")),
              HasSubstr("group"));
}

TEST(TopologyDefinition, AcksWhatIsSentWhenItIsConfirmedUnlessOnlyTheNewestCounts) {
  const auto ack_when = [](const std::string& properties) {
    const auto definition = TopologyDefinition::parse(
        with_bolt("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f, driverID]\n    properties: " +
                  properties + "\n"),
        "t.yaml");
    return definition.bolts.at(0).endpoint->sending.ack_when;
  };
  EXPECT_EQ(ack_when("{capacity: 1}"), AckWhen::confirmed);
  EXPECT_EQ(ack_when("{whenFull: keep_newest}"), AckWhen::accepted);
  EXPECT_EQ(ack_when("{whenFull: keep_newest, ackWhen: confirmed}"), AckWhen::confirmed);
  EXPECT_EQ(ack_when("{ackWhen: accepted}"), AckWhen::accepted);
}

TEST(TopologyDefinition, LetsTwoSpoutsReadOneChannelInDifferentGroupsOnly) {
  const std::string second = "  second:\n" + good_spout;
  EXPECT_THAT(error_of(with_spout(good_spout + second)), HasSubstr("reads this driver's channel already"));
  EXPECT_THAT(error_of(with_spout(good_spout + "    group: g\n" + second + "    group: g\n")),
              HasSubstr("reads this driver's channel already"));
  EXPECT_EQ(error_of(with_spout(good_spout + second + "    group: g\n")), "");
}

TEST(TopologyDefinition, RefusesTheMarkOfPartitionsInTheNamesOfKafkasGroups) {
  const auto problem = [](const std::string& name, const std::string& broker, const std::string& group) {
    return error_of("registry: embedded://x\ntopology.name: \"" + name +
                    "\"\nbrokers: {kafkaesque: \"amqp://127.0.0.1\", lab: {urls: [\"kafkas://127.0.0.1:9093\"]}}\n"
                    "spouts:\n  s: {broker: " +
                    broker + ", driver: d, channel: c, fields: [f]" + group + "}\n");
  };
  const std::string mark = "has a \"#\", behind which Kafka's groups have the number of a partition";
  EXPECT_THAT(problem("a#1", "kafka", ""), AllOf(HasSubstr("topology.name: \"a#1\" " + mark)));
  EXPECT_THAT(problem("a#1", "lab", ""), HasSubstr("topology.name: "));
  EXPECT_THAT(problem("a", "kafka", ", group: \"g#2\""), HasSubstr("spouts.s.group: \"g#2\" " + mark));
  EXPECT_EQ(problem("a#1", "kafka", ", group: g"), "") << "Kafka's groups are not named by it";
  EXPECT_EQ(problem("a#1", "kafkaesque", ", group: \"g#2\""), "");
}

TEST(TopologyDefinition, WithoutFurtherKeysHasAsManyTasksAsExecutorsAndNoDeadlines) {
  const auto definition =
      TopologyDefinition::parse(with_bolt("    class: x\n    parallelism: 3\n    inputs: {from: s}\n"), "t.yaml");
  EXPECT_TRUE(definition.runtime.acking);
  EXPECT_THAT(definition.spouts.at(0).endpoint->reading.dead_letter, IsEmpty());
  EXPECT_FALSE(definition.spouts.at(0).max_spout_pending.has_value());
  const auto& bolt = definition.bolts.at(0);
  EXPECT_EQ(bolt.tasks, 3);
  EXPECT_EQ(bolt.deadline.count(), 0);
  EXPECT_FALSE(bolt.worker_scope);
  EXPECT_EQ(bolt.inputs.at(0).deadline.count(), 0);
  EXPECT_EQ(bolt.inputs.at(0).keep_last, 0U);
}

struct Wrong {
  const char* what;
  std::string text;
  const char* place;   ///< file:line:column: key
  const char* remedy;  ///< what would be right
};
void PrintTo(const Wrong& wrong, std::ostream* out) {
  *out << wrong.what;
}

class WrongFile : public ::testing::TestWithParam<Wrong> {};

TEST_P(WrongFile, IsRefusedWithPlaceAndRemedy) {
  EXPECT_THAT(error_of(GetParam().text), AllOf(HasSubstr(GetParam().place), HasSubstr(GetParam().remedy)));
}

INSTANTIATE_TEST_SUITE_P(
    TopologyDefinition, WrongFile,
    ::testing::Values(
        Wrong{"unknown key at the top", "zk.server: [a:1]\ntopology.name: t\n", "t.yaml:1:1: zk.server", "zk.servers"},
        Wrong{"no name", "zk.servers: [a:2181]\n", "t.yaml:1:1", "topology.name"},
        Wrong{"a name with a slash", "topology.name: a/b\n", "t.yaml:1:1: topology.name", "slash"},
        Wrong{"a server without port", "topology.name: t\nzk.servers: [a]\n", "t.yaml:2:1: zk.servers", "host:port"},
        Wrong{"a root that is no path", "topology.name: t\nzk.root: iot\n", "t.yaml:2:1: zk.root", "/iot/sensors"},
        Wrong{"spouts of the wrong type", "topology.name: t\nspouts: [a]\n", "t.yaml:2:1: spouts", "mapping"},
        Wrong{"unknown key in a spout", with_spout(good_spout + "    brokr: x\n"), "t.yaml:9:5: spouts.s.brokr",
              "broker"},
        Wrong{"neither broker nor class", with_spout("    driver: d\n"), "t.yaml:5:5: spouts.s", "class"},
        Wrong{"broker and class", with_spout(good_spout + "    class: x\n"), "t.yaml:9:5: spouts.s.class", "remove"},
        Wrong{"unknown broker", with_spout("    broker: rabitmq\n    driver: d\n    channel: c\n    fields: [f]\n"),
              "t.yaml:5:5: spouts.s.broker", "did you mean \"rabbitmq\""},
        Wrong{"no driver", with_spout("    broker: rabbitmq\n    channel: c\n    fields: [f]\n"),
              "t.yaml:5:5: spouts.s", "driver"},
        Wrong{"a driver that cannot be", with_spout("    broker: rabbitmq\n    driver: a/b\n"),
              "t.yaml:6:5: spouts.s.driver", "slash"},
        Wrong{"driver and sensor", with_spout("    broker: rabbitmq\n    driver: a\n    sensor: a\n"),
              "t.yaml:7:5: spouts.s.sensor", "remove"},
        Wrong{"no channel", with_spout("    broker: rabbitmq\n    driver: d\n    fields: [f]\n"),
              "t.yaml:5:5: spouts.s", "channel"},
        Wrong{"no fields", with_spout("    broker: rabbitmq\n    driver: d\n    channel: c\n"), "t.yaml:5:5: spouts.s",
              "fields"},
        Wrong{"two payloads", with_spout("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f, g]\n"),
              "t.yaml:8:5: spouts.s.fields", "second field"},
        Wrong{"no payload", with_spout("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [time]\n"),
              "t.yaml:8:5: spouts.s.fields", "payload"},
        Wrong{"a field twice", with_spout("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f, f]\n"),
              "t.yaml:8:5: spouts.s.fields", "twice"},
        Wrong{"unknown ackMode", with_spout(good_spout + "    properties: {ackMode: never}\n"),
              "t.yaml:9:18: spouts.s.properties.ackMode", "manual"},
        Wrong{"prefetchCount out of range", with_spout(good_spout + "    properties: {prefetchCount: 0}\n"),
              "t.yaml:9:18: spouts.s.properties.prefetchCount", "from 1"},
        Wrong{"dead letters of what nobody hears of",
              with_spout(good_spout + "    properties: {ackMode: auto, deadLetter: lost}\n"),
              "t.yaml:9:33: spouts.s.properties.deadLetter", "ackMode: manual"},
        Wrong{"a dead-letter topic that cannot be", with_spout(good_spout + "    properties: {deadLetter: a/b}\n"),
              "t.yaml:9:18: spouts.s.properties.deadLetter", "slash"},
        Wrong{"unknown property", with_spout(good_spout + "    properties: {prefetch: 5}\n"),
              "t.yaml:9:18: spouts.s.properties.prefetch", "prefetchCount"},
        Wrong{"inputs of a spout", with_spout(good_spout + "    inputs: []\n"), "t.yaml:9:5: spouts.s.inputs",
              "unknown key"},
        Wrong{"two readers of one channel", with_spout(good_spout + "  s2:\n" + good_spout),
              "t.yaml:12:5: spouts.s2.channel", "one spout"},
        Wrong{"unknown grouping", with_bolt("    class: x\n    inputs: [{from: s, grouping: shufle}]\n"),
              "t.yaml:12:24: bolts.b.inputs[0].grouping", "did you mean \"shuffle\""},
        Wrong{"fields grouping without key", with_bolt("    class: x\n    inputs: [{from: s, grouping: fields}]\n"),
              "t.yaml:12:24: bolts.b.inputs[0].grouping", "fields: [driverID]"},
        Wrong{"a key where none is used", with_bolt("    class: x\n    inputs: [{from: s, fields: [f]}]\n"),
              "t.yaml:12:24: bolts.b.inputs[0].fields", "grouping: fields"},
        Wrong{"an input without source", with_bolt("    class: x\n    inputs: [{grouping: all}]\n"),
              "t.yaml:12:14: bolts.b.inputs[0]", "from"},
        Wrong{"a tick without unit", with_bolt("    class: x\n    tick: 5\n"), "t.yaml:12:5: bolts.b.tick", "unit"},
        Wrong{"parallelism of nothing", with_bolt("    class: x\n    parallelism: 0\n"),
              "t.yaml:12:5: bolts.b.parallelism", "from 1"},
        Wrong{"less tasks than executors", with_bolt("    class: x\n    parallelism: 3\n    tasks: 2\n"),
              "t.yaml:13:5: bolts.b.tasks", "as many tasks or more"},
        Wrong{"a deadline without unit", with_bolt("    class: x\n    deadline: 50\n"), "t.yaml:12:5: bolts.b.deadline",
              "50ms"},
        Wrong{"a late stream without deadline", with_bolt("    class: x\n    late_stream: late\n"),
              "t.yaml:12:5: bolts.b.late_stream", "add \"deadline"},
        Wrong{"late tuples among the others", with_bolt("    class: x\n    deadline: 1s\n    late_stream: default\n"),
              "t.yaml:13:5: bolts.b.late_stream", "stream of their own"},
        Wrong{"a spout with a deadline", with_spout(good_spout + "    deadline: 1s\n"), "t.yaml:9:5: spouts.s.deadline",
              "on the bolts"},
        Wrong{"a spout with a tick", with_spout(good_spout + "    tick: 1s\n"), "t.yaml:9:5: spouts.s.tick",
              "on the bolts"},
        Wrong{"a limit that is no number", with_spout(good_spout + "    max_spout_pending: many\n"),
              "t.yaml:9:5: spouts.s.max_spout_pending", "whole number"},
        Wrong{"a limit of tuples under way on a bolt", with_bolt("    class: x\n    max_spout_pending: 1\n"),
              "t.yaml:12:5: bolts.b.max_spout_pending", "unknown key"},
        Wrong{"keeping less than nothing", with_bolt("    class: x\n    inputs: [{from: s, keep_last: -1}]\n"),
              "t.yaml:12:24: bolts.b.inputs[0].keep_last", "from 0"},
        Wrong{"a key of nothing that is kept", with_bolt("    class: x\n    inputs: [{from: s, keep_key: [f]}]\n"),
              "t.yaml:12:24: bolts.b.inputs[0].keep_key", "keep_last: 1"},
        Wrong{"a custom grouping without class", with_bolt("    class: x\n    inputs: [{from: s, grouping: custom}]\n"),
              "t.yaml:12:24: bolts.b.inputs[0].grouping", "class: my.Grouping"},
        Wrong{"a class of a grouping that has none", with_bolt("    class: x\n    inputs: [{from: s, class: my.G}]\n"),
              "t.yaml:12:24: bolts.b.inputs[0].class", "grouping: custom"},
        Wrong{"an unknown scope", with_bolt("    class: x\n    scope: workers\n"), "t.yaml:12:5: bolts.b.scope",
              "did you mean \"worker\""},
        Wrong{"a sending bolt with a tick",
              with_bolt("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f, driverID]\n"
                        "    tick: 1s\n"),
              "t.yaml:15:5: bolts.b.tick", "by itself"},
        Wrong{"acking of neither kind", "topology.name: t\nruntime: {acking: 0}\n", "t.yaml:2:11: runtime.acking",
              "true or false"},
        Wrong{"unknown policy",
              with_bolt("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f]\n"
                        "    properties: {whenFull: drop}\n"),
              "t.yaml:15:18: bolts.b.properties.whenFull", "keep_newest"},
        Wrong{"a sending bolt that does not say to whom",
              with_bolt("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f]\n"),
              "t.yaml:14:5: bolts.b.fields", "driverID"},
        Wrong{"a negative number of threads", "topology.name: t\nruntime: {threads: -1}\n",
              "t.yaml:2:11: runtime.threads", "from 0"}));

}  // namespace
}  // namespace iotcloud::topology
