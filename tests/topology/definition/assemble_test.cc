#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/definition/definition_texts.h>
#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/definition/describe.h>

namespace iotcloud::topology {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;
using ::testing::StartsWith;
using texts::good_spout;
using texts::paper_example;
using texts::with_bolt;
using texts::with_spout;

class EmptySpout final : public Spout {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"f"}); }
  void open(const Config&, const TopologyContext&, SpoutOutputCollector&) override {}
  bool next_tuple() override { return false; }
};
class PassBolt final : public BasicBolt {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"control", "driverID", "time"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override { collector.emit(Values(tuple.at(0))); }
};

class FirstTask final : public Grouping {
 public:
  void prepare(const TopologyContext&, const Fields&, std::span<const int> targets) override {
    first_ = targets.front();
  }
  void choose(const Values&, std::vector<int>& chosen) override { chosen.push_back(first_); }

 private:
  int first_ = 0;
};

class NoBuilder final : public MessageBuilder {};

class Assemble : public ::testing::Test {
 protected:
  Assemble() {
    components.add_builder<NoBuilder>("test.Builder");
    components.add_bolt<PassBolt>("test.Pass");
    components.add_spout<EmptySpout>("test.Empty");
    components.add_grouping<FirstTask>("test.FirstTask");
  }
  Topology assemble_text(const std::string& text) {
    const EndpointFactories endpoints{
        [](const ComponentDefinition&) { return [] { return std::make_unique<EmptySpout>(); }; },
        [](const ComponentDefinition&) { return [] { return make_bolt<PassBolt>(); }; }};
    return assemble(TopologyDefinition::parse(text, "t.yaml"), components, endpoints);
  }
  std::string refusal(const std::string& text) {
    try {
      static_cast<void>(assemble_text(text));
    } catch (const config::ConfigError& e) {
      return e.what();
    }
    return "";
  }
  ComponentRegistry components;
};

TEST_F(Assemble, FindsTheBuilderOfALibraryAndRefusesOneThatNobodyRegisters) {
  const auto with_builder = [](const std::string& name) {
    return with_spout("    broker: rabbitmq\n    driver: d\n    channel: c\n    builder: " + name +
                      "\n    fields: [f]\n");
  };
  EXPECT_EQ(refusal(with_builder("test.Builder")), "");
  EXPECT_EQ(refusal(with_builder("json")), "");
  EXPECT_THAT(refusal(with_builder("test.Bilder")),
              AllOf(StartsWith("t.yaml:8:5: spouts.s.builder"), HasSubstr("did you mean \"test.Builder\"?")));
  EXPECT_THAT(refusal(with_builder("protobuf")),
              HasSubstr("there are \"bytes\", \"text\", \"json\", \"test.Builder\""));
}

TEST_F(Assemble, JoinsTheOuterLayerInYamlWithTheAlgorithmInCpp) {
  components.set_application([](TopologyBuilder& builder, const Config&) {
    builder.set_bolt<PassBolt>("count").shuffle_grouping("kinect_receive");
    builder.bolt("count_send").fields_grouping("count", Fields{"driverID"});
  });
  const auto topology = assemble_text(paper_example);
  ASSERT_THAT(topology.components, SizeIs(3));
  EXPECT_EQ(topology.components[0].id, "kinect_receive");
  EXPECT_EQ(topology.components[1].id, "count");
  EXPECT_EQ(topology.components[2].id, "count_send");
}

TEST_F(Assemble, HandsEveryKeyOnToTheGraph) {
  const auto topology = assemble_text(
      with_spout(good_spout + "    tasks: 2\n    max_spout_pending: 5\n") +
      "bolts:\n  b:\n    class: test.Pass\n    parallelism: 2\n    tasks: 4\n    tick: 1s\n    deadline: 50ms\n"
      "    late_stream: late\n    inputs:\n"
      "      - {from: s, deadline: 20ms, keep_last: 3, keep_key: [f]}\n"
      "      - {from: s, grouping: custom, class: test.FirstTask}\n"
      "  late:\n    class: test.Pass\n    inputs: {from: b, stream: late}\n");
  ASSERT_THAT(topology.components, SizeIs(3));
  const auto& spout = topology.components[0];
  EXPECT_EQ(spout.parallelism, 1);
  EXPECT_EQ(spout.tasks, 2);
  EXPECT_EQ(spout.max_spout_pending, 5U);
  const auto& bolt = topology.components[1];
  EXPECT_EQ(bolt.parallelism, 2);
  EXPECT_EQ(bolt.tasks, 4);
  EXPECT_EQ(bolt.tick, std::chrono::seconds(1));
  EXPECT_EQ(bolt.deadline, std::chrono::milliseconds(50));
  EXPECT_EQ(bolt.late_stream, "late");
  EXPECT_EQ(bolt.inputs.at(0).deadline, std::chrono::milliseconds(20));
  EXPECT_EQ(bolt.inputs.at(0).keep_last, 3U);
  EXPECT_EQ(bolt.inputs.at(0).keep_key, Fields({"f"}));
  EXPECT_EQ(bolt.inputs.at(1).deadline.count(), 0);
  EXPECT_NE(dynamic_cast<FirstTask*>(bolt.inputs.at(1).factory().get()), nullptr);
  EXPECT_EQ(topology.components[2].inputs.at(0).stream, "late");
}

TEST_F(Assemble, RefusesAnUnknownGroupingClassAtItsInput) {
  EXPECT_THAT(refusal(with_bolt("    class: test.Pass\n"
                                "    inputs: [{from: s, grouping: custom, class: test.FirstTusk}]\n")),
              AllOf(StartsWith("t.yaml:12:42: bolts.b.inputs[0].class"), HasSubstr("did you mean \"test.FirstTask\"")));
}

TEST_F(Assemble, RefusesAKeyOfKeepLastThatTheSourceDoesNotDeclare) {
  EXPECT_THAT(refusal(with_bolt("    class: test.Pass\n    inputs: {from: s, keep_last: 1, keep_key: [g]}\n")),
              AllOf(StartsWith("t.yaml:10:3: bolts.b"), HasSubstr("\"g\""), HasSubstr("keep_last")));
}

TEST_F(Assemble, IsDescribedInTheOrderOfTheFlow) {
  components.set_application([](TopologyBuilder& builder, const Config&) {
    builder.set_bolt<PassBolt>("count", 2).shuffle_grouping("kinect_receive").keep_last(1);
    builder.bolt("count_send").fields_grouping("count", Fields{"driverID"});
  });
  const std::string text =
      std::string(paper_example) +
      "    tasks: 3\n    deadline: 500us\n    inputs: {from: count, grouping: global, deadline: 2s}\n"
      "  twice: {class: test.Pass, inputs: {from: kinect_receive, grouping: custom, class: test.FirstTask}}\n";
  const auto definition = TopologyDefinition::parse(text, "t.yaml");
  EXPECT_EQ(describe(definition, assemble_text(text)),
            R"(topology wordcount: 4 components
registry zookeeper://server1:2181, drivers below /iot/sensors

spout kinect_receive: 1 executor, 1 task; reads channel "kinect" of driver "turtle", broker "rabbitmq"
  -> f

bolt twice: 1 executor, 1 task; class test.Pass
  <- kinect_receive, custom test.FirstTask
  -> control, driverID, time

bolt count: 2 executors, 2 tasks; made by the application
  <- kinect_receive, shuffle, keeps the last of all
  -> control, driverID, time

bolt count_send: 1 executor, 3 tasks; sends to channel "control" of driver "turtle", broker "rabbitmq"
  <- count, fields (driverID)
  <- count, global, deadline 2 s
  deadline 500 us
  ticks every 1 s
  -> control, driverID, time

These inputs reach across drivers, and each worker has only its own drivers' tuples: one worker alone may run this, unless "scope: worker" says that each worker processes its own tuples only:
  count_send <- count, global
)");
}

TEST_F(Assemble, IsDescribedWithWhere) {
  const std::string text =
      "topology.name: t\nspouts:\n  s:\n    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f]\n"
      "    where: |\n      site == \"lab\"\n      and battery > 20\n";
  const std::string described = describe(TopologyDefinition::parse(text, "t.yaml"), assemble_text(text));
  EXPECT_THAT(described, HasSubstr("of driver \"d\" where site == \"lab\" and battery > 20, broker"));
}

TEST_F(Assemble, IsDescribedWithItsGroup) {
  const std::string text = "topology.name: t\nspouts:\n  s:\n" + good_spout + "    group: lab\n";
  EXPECT_THAT(describe(TopologyDefinition::parse(text, "t.yaml"), assemble_text(text)),
              HasSubstr("broker \"rabbitmq\", shared with all of group \"lab\""));
}

TEST_F(Assemble, RefusesAGroupWhereTuplesOfSeveralDriversAreToMeetUnlessTheFileSaysWorkerScope) {
  const auto text = [](const std::string& scope) {
    return with_spout(good_spout + "    group: lab\n") +
           "bolts:\n  b: {class: test.Pass, inputs: {from: s, grouping: global}" + scope + "}\n";
  };
  EXPECT_THAT(refusal(text("")),
              AllOf(StartsWith("t.yaml:9:5: spouts.s.group"), HasSubstr("b <- s, global"), HasSubstr("scope: worker")));
  EXPECT_EQ(refusal(text(", scope: worker")), "");
}

TEST_F(Assemble, IsDescribedWithoutAWarningWhereEachWorkerForItselfIsMeant) {
  const std::string text = with_bolt("    class: test.Pass\n    scope: worker\n    inputs: {from: s, grouping: all}\n");
  const std::string described = describe(TopologyDefinition::parse(text, "t.yaml"), assemble_text(text));
  EXPECT_THAT(described, AllOf(HasSubstr("scope worker"), Not(HasSubstr("reach across drivers"))));
}

TEST_F(Assemble, RefusesABoltWithoutInputInTheMergedGraph) {
  EXPECT_THAT(refusal(paper_example), AllOf(StartsWith("t.yaml:11:3: bolts.count_send"), HasSubstr("no input")));
}

TEST_F(Assemble, RefusesACycleByName) {
  const std::string text = with_bolt("    class: test.Pass\n    inputs: [{from: s}, {from: b2}]\n") +
                           "  b2:\n    class: test.Pass\n    inputs: {from: b}\n";
  EXPECT_THAT(refusal(text), AllOf(StartsWith("t.yaml:1"), HasSubstr("cycle"), HasSubstr("b2")));
}

TEST_F(Assemble, RefusesAnUnknownClassWithASuggestion) {
  EXPECT_THAT(refusal(with_bolt("    class: test.Pas\n    inputs: {from: s}\n")),
              AllOf(StartsWith("t.yaml:11:5: bolts.b.class"), HasSubstr("did you mean \"test.Pass\"")));
}

TEST_F(Assemble, RefusesAnUnknownSourceAtItsInput) {
  EXPECT_THAT(refusal(with_bolt("    class: test.Pass\n    inputs: {from: spout}\n")),
              AllOf(StartsWith("t.yaml:12:14: bolts.b.inputs.from"), HasSubstr("spout")));
}

TEST_F(Assemble, RefusesAKeyThatTheSourceDoesNotDeclare) {
  EXPECT_THAT(refusal(with_bolt("    class: test.Pass\n    inputs: {from: s, grouping: fields, fields: [g]}\n")),
              AllOf(StartsWith("t.yaml:10:3: bolts.b"), HasSubstr("\"g\"")));
}

TEST_F(Assemble, RefusesASendingBoltWhoseFieldsItsInputDoesNotHave) {
  EXPECT_THAT(refusal(with_bolt("    broker: rabbitmq\n    driver: d\n    channel: c\n    fields: [f, driverID]\n"
                                "    inputs: {from: s}\n")),
              AllOf(StartsWith("t.yaml:14:5: bolts.b.fields"), HasSubstr("driverID")));
}

TEST_F(Assemble, RefusesATopologyWithoutSpout) {
  EXPECT_THAT(refusal("topology.name: t\n"), AllOf(StartsWith("t.yaml:1:1"), HasSubstr("no spout")));
}

TEST_F(Assemble, SaysWhenTheApplicationThrows) {
  components.set_application([](TopologyBuilder&, const Config&) { throw std::runtime_error("no map"); });
  EXPECT_THAT(refusal(paper_example), AllOf(StartsWith("t.yaml:1:1"), HasSubstr("no map")));
}

}  // namespace
}  // namespace iotcloud::topology
