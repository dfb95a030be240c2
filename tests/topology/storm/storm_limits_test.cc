// STORM's limits: what a topology's file asks for and Storm cannot do is refused at its place, with what to do instead.
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/topology/definition/assemble.h>
#include <iotcloud/topology/storm/job/classes.h>
#include <iotcloud/topology/storm/job/job.h>
#include <iotcloud/topology/storm/job/storm_limits.h>

namespace iotcloud::topology::storm {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

struct Numbers final : Spout {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"n", "driverID"});
  }
  void open(const Config&, const TopologyContext&, SpoutOutputCollector&) override {}
  bool next_tuple() override { return false; }
};
struct Pass final : BasicBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare(Fields{"n"}); }
  void execute(const Tuple&, BasicOutputCollector&) override {}
};
struct System final : BasicBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare_stream("__own", Fields{"n"});
  }
  void execute(const Tuple&, BasicOutputCollector&) override {}
};
struct TenSeconds final : Bolt {
  void prepare(const Config&, const TopologyContext&, OutputCollector&) override {}
  void execute(const Tuple&) override {}
  std::chrono::microseconds holds_tuples_for(const Config&) const override { return std::chrono::seconds(10); }
};

/// The notes on a file; what is refused is thrown.
std::vector<std::string> notes_on(const std::string& yaml) {
  ComponentRegistry components;
  components.add_spout<Numbers>("Numbers");
  components.add_bolt<Pass>("Pass");
  components.add_bolt<System>("System");
  components.add_bolt<TenSeconds>("TenSeconds");
  EndpointFactories endpoints{
      .spout = [](const ComponentDefinition&) { return [] { return std::make_unique<Numbers>(); }; },
      .bolt = [](const ComponentDefinition&) { return [] { return make_bolt<Pass>(); }; }};
  const auto definition = TopologyDefinition::parse(yaml, "t.yaml");
  return check_limits(definition, assemble(definition, components, endpoints));
}

std::string refusal_of(const std::string& yaml) {
  try {
    static_cast<void>(notes_on(yaml));
  } catch (const config::ConfigError& error) {
    return error.what();
  }
  return "";
}

/// Lines 1 to 4 of a file, whose bolts begin in line 5.
const std::string head = "topology.name: t\nspouts:\n  in: {class: Numbers}\nbolts:\n";

struct Row {
  const char* name;
  std::string yaml;
  const char* place;
  const char* remedy;
};

class StormLimits : public testing::TestWithParam<Row> {};

TEST_P(StormLimits, AreRefusedAtTheirPlace) {
  EXPECT_THAT(refusal_of(GetParam().yaml), AllOf(HasSubstr(GetParam().place), HasSubstr(GetParam().remedy)));
}

const std::vector<Row> rows{
    {"Name", "topology.name: a.b\nspouts:\n  in: {class: Numbers}\n", "t.yaml:1:1: topology.name", "write \"-\""},
    {"EndpointWithoutRegistry",
     "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: c, fields: [n]}\n",
     "t.yaml:1:1: ", "zk.servers: [host:2181]"},
    {"EmbeddedRegistry",
     "topology.name: t\nregistry: \"embedded://x\"\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: c, fields: "
     "[n]}\n",
     "t.yaml:2:1: registry", "zk.servers: [host:2181]"},
    {"EmbeddedBroker",
     "topology.name: t\nzk.servers: [\"h:2181\"]\nbrokers: {mine: \"embedded://x\"}\nspouts:\n  in: {broker: mine, "
     "driver: d, "
     "channel: c, fields: [n]}\n",
     "t.yaml:3:11: brokers.mine", "name a broker's server"},
    {"SystemStream", head + "  b: {class: System, inputs: {from: in}}\n", "t.yaml:5:7: bolts.b.class", "another name"},
    {"StreamTwice", head + "  b: {class: Pass, inputs: [{from: in}, {from: in, grouping: all}]}\n",
     "t.yaml:5:20: bolts.b.inputs", "remove an input"},
    {"ScopeOfABolt", head + "  b: {class: Pass, scope: worker, inputs: {from: in, grouping: global}}\n",
     "t.yaml:5:20: bolts.b.scope", "remove \"scope\""},
    {"ScopeOfATopology",
     "topology.name: t\ntopology.scope: worker\nspouts:\n  in: {class: Numbers}\nbolts:\n  b: {class: Pass, inputs: "
     "{from: in, "
     "grouping: fields, fields: [n]}}\n",
     "t.yaml:2:1: topology.scope", "remove \"scope\""},
    {"StateOnOneDisk", head + "  b: {class: Pass, conf: {state.store: \"rocksdb:///var/lib/x\"}, inputs: {from: in}}\n",
     "t.yaml:5:27: bolts.b.conf.state.store", "engine.storm.shared_folders"},
    {"StateOfSeveralTasksInOneDatabase",
     "engine: {storm: {shared_folders: [/mnt/s]}}\n" + head +
         "  b: {class: Pass, tasks: 2, conf: {state.store: \"rocksdb:///mnt/s/x\"}, inputs: {from: in}}\n",
     "t.yaml:6:37: bolts.b.conf.state.store", "one task and a RocksDB of its own"},
    {"StateOfSeveralBoltsInOneDatabase",
     "engine: {storm: {shared_folders: [/mnt/s]}}\nconf: {state.store: \"rocksdb:///mnt/s/x\"}\n" + head +
         "  b: {class: Pass, inputs: {from: in}}\n",
     "t.yaml:2:8: conf.state.store", "one task and a RocksDB of its own"},
    {"PasswordInConf", head + "  b: {class: Pass, conf: {state.store: \"redis://u:p@h\"}, inputs: {from: in}}\n",
     "t.yaml:5:27: bolts.b.conf.state.store", "into a file"},
    {"KeyOfAComponentForAPassword", head + "  b: {class: Pass, conf: {db.Password: p}, inputs: {from: in}}\n",
     "t.yaml:5:27: bolts.b.conf.db.Password", "into a file"},
    {"PasswordOfABroker", "topology.name: t\nbrokers: {rabbitmq: \"amqp://u:p@h\"}\nspouts:\n  in: {class: Numbers}\n",
     "t.yaml:2:11: brokers.rabbitmq", "password_file"},
    {"PasswordOfTheRegistry", "topology.name: t\nregistry: \"zookeeper://u:p@h\"\nspouts:\n  in: {class: Numbers}\n",
     "t.yaml:2:1: registry", "password_file"},
    {"PasswordInStormsConf",
     "engine: {storm: {conf: {topology.x: '[\"http://h/a\", \"redis://u:p@h\"]'}}}\n" + head +
         "  b: {class: Pass, inputs: {from: in}}\n",
     "t.yaml:1:25: engine.storm.conf.topology.x", "a file on the machines"},
    {"KeyOfStormForAPassword",
     "engine: {storm: {conf: {topology.db.Password: p}}}\n" + head + "  b: {class: Pass, inputs: {from: in}}\n",
     "t.yaml:1:25: engine.storm.conf.topology.db.Password", "a file on the machines"},
    {"PasswordAmongTheWorkersOptions",
     "engine: {storm: {worker_options: \"-Xmx1g -Djavax.net.ssl.keyStorePassword=p\"}}\n" + head +
         "  b: {class: Pass, inputs: {from: in}}\n",
     "t.yaml:1:18: engine.storm.worker_options", "a file on the machines"},
    {"UrlWithPasswordAmongTheWorkersOptions",
     "engine: {storm: {worker_options: \"-Dproxy=http://u:p@h:80 -Xmx1g\"}}\n" + head +
         "  b: {class: Pass, inputs: {from: in}}\n",
     "t.yaml:1:18: engine.storm.worker_options", "a file on the machines"},
    {"LongWindow", "runtime: {message_timeout: 10s}\n" + head + "  b: {class: TenSeconds, inputs: {from: in}}\n",
     "t.yaml:6:7: bolts.b.class", "set \"runtime.message_timeout\" to twice 10s"},
    {"KeyOfStormThatIsSaidElsewhere",
     "engine: {storm: {conf: {topology.workers: 2}}}\n" + head + "  b: {class: Pass, inputs: {from: in}}\n",
     "t.yaml:1:25: engine.storm.conf.topology.workers", "engine.storm.workers"},
    {"KeyThatIsNoTopologys",
     "engine: {storm: {conf: {nimbus.seeds: x}}}\n" + head + "  b: {class: Pass, inputs: {from: in}}\n",
     "t.yaml:1:25: engine.storm.conf.nimbus.seeds", "begin with \"topology.\""},
};

INSTANTIATE_TEST_SUITE_P(Rows, StormLimits, testing::ValuesIn(rows),
                         [](const auto& given) { return std::string(given.param.name); });

TEST(StormLimitsTest, AllErrorsOfAFileAreSaidTogether) {
  EXPECT_THAT(
      refusal_of("topology.name: a.b\nspouts:\n  in: {class: Numbers}\nbolts:\n  b: {class: Pass, scope: worker, "
                 "inputs: {from: in, grouping: all}}\n"),
      AllOf(HasSubstr("topology.name"), HasSubstr("bolts.b.scope")));
}

TEST(StormLimitsTest, WhatStormCanDoIsNotRefused) {
  EXPECT_THAT(
      notes_on(
          "runtime: {message_timeout: 11s}\nengine: {storm: {shared_folders: [/mnt/s], worker_options: "
          "\"-Dpassword_file=/etc/p -Dproxy=http://h:80 -Dmail=a@b\", conf: {topology.password.file: /etc/p}}}\n" +
          head +
          "  b: {class: Pass, scope: worker, deadline: 1s, tick: 100ms, conf: {state.store: \"rocksdb:///mnt/s/x\"}, "
          "inputs: {from: in, grouping: fields, fields: [driverID]}}\n"
          "  c: {class: TenSeconds, inputs: [{from: in, grouping: partial_key, fields: [n, driverID]}, {from: b}]}\n"),
      IsEmpty());
}

TEST(StormLimitsTest, WhatHoldsInAnotherWayIsNoted) {
  EXPECT_THAT(
      notes_on("runtime: {message_timeout: 1500ms, threads: 2}\n" + head +
               "  b: {class: Pass, conf: {state.store: \"memory://x\"}, inputs: {from: in}}\n"),
      ElementsAre(HasSubstr("b: its state is in memory"), HasSubstr("so it is 2s"), HasSubstr("runtime.threads")));
}

TEST(StormConf, HasWhatTheFileSays) {
  const auto definition = TopologyDefinition::parse(
      "runtime: {acking: false, max_spout_pending: 7, mailbox_capacity: 64, message_timeout: 1500ms}\n"
      "engine: {storm: {workers: 3, bolt_wait: 5ms, worker_options: \"-Xmx1g\", conf: {topology.debug: true, "
      "topology.kryo.register: '[\"a.B\"]', topology.x: text}}}\n" +
          head + "  b: {class: Pass, inputs: {from: in}}\n",
      "t.yaml");
  const std::string conf = storm_conf(definition);
  for (const char* part :
       {"\"topology.workers\":3", "\"topology.acker.executors\":0", "\"topology.max.spout.pending\":7",
        "\"topology.executor.receive.buffer.size\":64", "\"topology.message.timeout.secs\":2",
        "\"topology.spout.wait.strategy\":\"org.apache.storm.policy.WaitStrategyPark\"",
        "\"topology.bolt.wait.strategy\":\"org.apache.storm.policy.WaitStrategyPark\"",
        "\"topology.backpressure.wait.strategy\":\"org.apache.storm.policy.WaitStrategyPark\"",
        "\"topology.bolt.wait.park.microsec\":5000", "\"topology.debug\":true", "\"topology.kryo.register\":[\"a.B\"]",
        "\"topology.x\":\"text\"", "\"-XX:ErrorFile=artifacts/hs_err_%p.log -Xmx1g\""}) {
    EXPECT_THAT(conf, HasSubstr(part));
  }
}

TEST(StormClasses, AreThoseThatALibraryRegistersWithTheirStreams) {
  const std::string classes = classes_of(COMPONENTS_LIBRARY);
  EXPECT_THAT(classes, HasSubstr(R"("test.Numbers":{"default":{"fields":["n","key","payload","text"],"direct":false},)"
                                 R"("chosen":{"fields":["n","key"],"direct":true}})"));
  EXPECT_THAT(classes, HasSubstr(R"("test.Count":{})"));
  EXPECT_THAT(classes, HasSubstr(R"("grouping":{"test.ByNumber":{},"test.Picky":{}})"));
}

TEST(StormClasses, ComeFromALibraryOnly) {
  EXPECT_THAT([] { static_cast<void>(classes_of("/usr/bin/env")); }, testing::Throws<config::Error>());
}

}  // namespace
}  // namespace iotcloud::topology::storm
