#include <map>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::Pair;

TEST(Runtime, RunsAChainOnTheThreadThatWakesTheSpout) {
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("pass", pass_bolt()).shuffle_grouping("in");
  builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("pass");
  config::Metrics metrics;
  RuntimeOptions options;
  options.threads = 2;
  options.metrics = &metrics;
  options.caller_slice = options.long_slice = 1h;  // however slow the machine is
  Runtime runtime(builder.build("chain"), options);
  runtime.start();
  ASSERT_TRUE(eventually([&] { return runtime.idle(); }));
  source->put(Values(7));
  ASSERT_EQ(sink->size(), 1U);  // done when put() returns
  EXPECT_EQ(sink->items[0].thread, std::this_thread::get_id());
  EXPECT_THAT(source->acked(), ElementsAre(1));
  EXPECT_TRUE(runtime.stop(120s));
}

TEST(Runtime, CallsASpoutsLifeInOrder) {
  Bench bench;
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("in");
  Runtime runtime(builder.build("life"), bench.options());
  runtime.start();
  runtime.run_until_idle();
  runtime.deactivate();
  runtime.run_until_idle();
  source->put(Values(1));
  EXPECT_EQ(sink->size(), 0U);  // not asked while deactivated
  runtime.activate();
  runtime.run_until_idle();
  EXPECT_EQ(sink->size(), 1U);
  EXPECT_TRUE(runtime.stop(0ms));
  EXPECT_THAT(source->calls(), ElementsAre("open", "activate", "deactivate", "activate", "deactivate", "close"));
  source->wake();  // harmless
}

/// Emits each number, odd ones to the stream "odd", and every tenth to "tenth", too, which nobody reads.
struct Sorting final : Bolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare({"value"});
    declarer.declare_stream("odd", {"value"});
    declarer.declare_stream("tenth", {"value"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { out = &collector; }
  void execute(const Tuple& tuple) override {
    const auto number = tuple.get<std::int64_t>("value");
    if (number % 2 == 0) out->emit(tuple, Values(number));
    if (number % 2 == 1) out->emit_to("odd", {&tuple, 1}, Values(number));
    if (number % 10 == 0) out->emit_to("tenth", {&tuple, 1}, Values(number));
    out->ack(tuple);
  }
  OutputCollector* out = nullptr;
};

TEST(Runtime, CountsWhatIsEmittedToEachOfSeveralStreams) {
  Bench bench;
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt(
          "sort", [] { return std::make_unique<Sorting>(); }, 2)
      .shuffle_grouping("in");
  builder.set_bolt("even", sink_bolt(sink)).shuffle_grouping("sort");
  builder.set_bolt("odd", sink_bolt(sink), 2).all_grouping("sort", "odd");
  Runtime runtime(builder.build("streams"), bench.options());
  runtime.start();
  for (int i = 0; i < 100; ++i) source->put(Values(i));
  runtime.run_until_idle();
  const Snapshot snapshot = runtime.snapshot();
  EXPECT_EQ(snapshot.component("sort").emitted, 110U);
  std::map<std::string, std::pair<std::uint64_t, std::uint64_t>> streams;
  for (const auto& one : snapshot.component("sort").streams) streams[one.stream] = {one.emitted, one.transferred};
  EXPECT_THAT(streams,
              ElementsAre(Pair("default", Pair(50U, 50U)), Pair("odd", Pair(50U, 100U)), Pair("tenth", Pair(10U, 0U))));
  EXPECT_THAT(snapshot.component("in").streams, IsEmpty()) << "it has one";
}

TEST(Runtime, CountsWhatABoltDidWithEachOfSeveralInputs) {
  Bench bench;
  auto source = std::make_shared<Source>();
  std::vector<Tuple> kept;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt<Sorting>("sort").shuffle_grouping("in");
  builder
      .set_bolt("join", bolt([&](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
                  const auto number = tuple.get<std::int64_t>("value");
                  if (number == 3) throw std::runtime_error("three");
                  kept.push_back(tuple);
                  if (number >= 90 && number < 99) return;  // 99 acks them, which comes last from each input
                  for (const Tuple& one : std::exchange(kept, {})) collector.ack(one);
                }))
      .shuffle_grouping("in")
      .shuffle_grouping("sort", "odd")
      .all_grouping("sort", "tenth");
  builder.set_bolt("even", sink_bolt(std::make_shared<Sink>()))
      .shuffle_grouping("sort")
      .fields_grouping("sort", {"value"});
  Runtime runtime(builder.build("inputs"), bench.options());
  runtime.start();
  for (int i = 0; i < 100; ++i) source->lay(Values(i));  // so that tuples of several inputs wait together
  source->wake();
  runtime.run_until_idle();
  const Snapshot snapshot = runtime.snapshot();
  const TaskSnapshot join = snapshot.component("join");
  EXPECT_EQ(join.executed, 160U);
  EXPECT_EQ(join.failed, 2U);
  std::map<std::string, std::vector<std::uint64_t>> inputs;
  for (const auto& one : join.inputs) inputs[one.from + "/" + one.stream] = {one.executed, one.acked, one.failed};
  EXPECT_THAT(inputs,
              ElementsAre(Pair("in/default", ElementsAre(100U, 99U, 1U)), Pair("sort/odd", ElementsAre(50U, 49U, 1U)),
                          Pair("sort/tenth", ElementsAre(10U, 10U, 0U))));
  EXPECT_THAT(snapshot.component("sort").inputs, IsEmpty()) << "it has one";
  EXPECT_THAT(snapshot.component("even").inputs, IsEmpty()) << "two groupings of one stream are one input";
  EXPECT_EQ(snapshot.component("even").executed, 100U);
}

TEST(Runtime, CountsEveryTuple) {
  Bench bench;
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("pass", pass_bolt()).shuffle_grouping("in");
  builder.set_bolt("out", sink_bolt(sink), 2).all_grouping("pass");
  Runtime runtime(builder.build("counts"), bench.options());
  runtime.start();
  for (int i = 0; i < 1000; ++i) source->put(Values(i));
  runtime.run_until_idle();
  const Snapshot snapshot = runtime.snapshot();
  EXPECT_EQ(snapshot.component("in").emitted, 1000U);
  EXPECT_EQ(snapshot.component("in").acked, 1000U);
  EXPECT_EQ(snapshot.component("in").pending, 0U);
  EXPECT_EQ(snapshot.component("pass").executed, 1000U);
  EXPECT_EQ(snapshot.component("pass").emitted, 1000U);
  EXPECT_EQ(snapshot.component("pass").transferred, 2000U);
  EXPECT_EQ(snapshot.component("out").acked, 2000U);
  EXPECT_EQ(snapshot.component("out").execute_latency.count, 1000U);  // of one of its two tasks
  double published = 0;
  for (const auto& sample : bench.metrics.collect()) {
    if (sample.name == "iotcloud_task_executed_total" && sample.labels.at("component") == "out") {
      published += sample.value;
    }
  }
  EXPECT_EQ(published, 2000);
}

TEST(Runtime, SharesOneTupleAmongAllItsReaders) {
  Bench bench;
  auto source = std::make_shared<Source>();
  std::vector<const std::byte*> seen;
  const auto look = bolt([&seen](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
    seen.push_back(tuple.get<Payload>("value").data());
    collector.ack(tuple);
  });
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("a", look, 3).all_grouping("in");
  builder.set_bolt("b", look).shuffle_grouping("in");
  Runtime runtime(builder.build("shared"), bench.options());
  runtime.start();
  const Payload payload = Payload::copy("a frame");
  source->put(Values(payload));
  runtime.run_until_idle();
  EXPECT_THAT(seen, ElementsAre(payload.data(), payload.data(), payload.data(), payload.data()));
  EXPECT_THAT(source->acked(), ElementsAre(1));
}

TEST(Runtime, FailsTheTupleOfABoltThatThrowsAndGoesOn) {
  Bench bench;
  auto source = std::make_shared<Source>();
  auto options = bench.options();
  std::vector<std::string> errors;
  options.on_error = [&](const std::string& component, int task, const std::string& text) {
    errors.push_back(component + "/" + std::to_string(task) + ": " + text);
  };
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("odd", bolt([](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
                  if (tuple.get<std::int64_t>("value") % 2 == 1) throw std::runtime_error("odd");
                  collector.ack(tuple);
                }))
      .shuffle_grouping("in");
  Runtime runtime(builder.build("throws"), options);
  runtime.start();
  for (int i = 1; i <= 4; ++i) source->put(Values(i));
  runtime.run_until_idle();
  EXPECT_THAT(source->acked(), ElementsAre(2, 4));
  EXPECT_THAT(source->failed(), ElementsAre(1, 3));
  const TaskSnapshot odd = runtime.snapshot().component("odd");
  EXPECT_EQ(odd.failed, 2U);
  EXPECT_EQ(odd.errors, 2U);
  EXPECT_EQ(odd.last_error, "execute() threw: odd");
  EXPECT_THAT(errors, ElementsAre("odd/2: execute() threw: odd", "odd/2: execute() threw: odd"));
}

/// For spouts that emit how often they were asked.
class CallCountingSpout : public Spout {
 public:
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"value"}); }
  void open(const Config&, const TopologyContext&, SpoutOutputCollector& collector) override {
    collector_ = &collector;
  }

 protected:
  SpoutOutputCollector* collector_ = nullptr;
  int calls_ = 0;
};

TEST(Runtime, AsksASpoutAgainThatThrewAndReportsIt) {
  struct Throwing : CallCountingSpout {
    bool next_tuple() override {
      if (++calls_ == 1) throw 42;
      if (calls_ == 2) collector_->emit(Values(calls_));
      return calls_ == 2;
    }
  };
  Bench bench;
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout<Throwing>("in");
  builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("in");
  Runtime runtime(builder.build("throws"), bench.options());
  runtime.start();
  runtime.run_until_idle();
  EXPECT_EQ(runtime.snapshot().component("in").errors, 1U);
  bench.clock.advance(1s);
  runtime.run_due_timers();
  runtime.run_until_idle();
  EXPECT_THAT(sink->numbers(), ElementsAre(2));
}

TEST(Runtime, PollsASpoutThatCannotWake) {
  struct Polled : CallCountingSpout {
    bool next_tuple() override {
      collector_->emit(Values(++calls_));
      return false;
    }
    std::chrono::microseconds poll_period() const override { return 10ms; }
  };
  Bench bench;
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout<Polled>("in");
  builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("in");
  Runtime runtime(builder.build("polled"), bench.options());
  runtime.start();
  runtime.run_until_idle();
  EXPECT_THAT(sink->numbers(), ElementsAre(1));
  for (int i = 0; i < 30; ++i) {
    bench.clock.advance(1ms);
    runtime.run_due_timers();
    runtime.run_until_idle();
  }
  EXPECT_THAT(sink->numbers(), ElementsAre(1, 2, 3, 4));
}

TEST(Runtime, SendsTicksAtTheirPeriodAndMissedOnesOnce) {
  Bench bench;
  auto source = std::make_shared<Source>();
  int ticks = 0;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("ticking", bolt([&](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
                  if (tuple.is_tick()) ++ticks;
                  collector.ack(tuple);
                }))
      .shuffle_grouping("in")
      .tick(100ms);
  Runtime runtime(builder.build("ticks"), bench.options());
  runtime.start();
  const auto pass = [&](std::chrono::milliseconds time) {
    bench.clock.advance(time);
    runtime.run_due_timers();
    runtime.run_until_idle();
  };
  pass(99ms);
  EXPECT_EQ(ticks, 0);
  pass(1ms);
  EXPECT_EQ(ticks, 1);
  pass(100ms);
  EXPECT_EQ(ticks, 2);
  pass(1050ms);
  EXPECT_EQ(ticks, 3);
  pass(50ms);
  EXPECT_EQ(ticks, 4);
  EXPECT_EQ(runtime.snapshot().component("ticking").executed, 0U);  // ticks are not data
}

TEST(Runtime, RefusesEmitsThatDoNotFit) {
  Bench bench;
  auto source = std::make_shared<Source>();
  std::vector<std::string> errors;
  auto options = bench.options();
  options.on_error = [&](const std::string&, int, const std::string& text) { errors.push_back(text); };
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("wrong", bolt(
                             [](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
                               switch (tuple.get<std::int64_t>("value")) {
                                 case 0:
                                   collector.emit(Values(1, 2));
                                   break;
                                 case 1:
                                   collector.emit_to("nowhere", {}, Values(1));
                                   break;
                                 default:
                                   collector.emit_direct(3, default_stream, {}, Values(1));
                               }
                             },
                             {"one"}))
      .shuffle_grouping("in");
  Runtime runtime(builder.build("wrong"), options);
  runtime.start();
  for (int i = 0; i < 3; ++i) source->put(Values(i));
  runtime.run_until_idle();
  EXPECT_THAT(errors, ElementsAre(testing::HasSubstr("emits 2 values to stream \"default\", whose fields are one"),
                                  testing::HasSubstr("stream \"nowhere\", which it does not declare"),
                                  testing::HasSubstr("not declared direct")));
  EXPECT_THAT(source->failed(), ElementsAre(1, 2, 3));
}

TEST(Runtime, SaysWhichComponentThrewWhenItWasOpened) {
  struct Unready : BasicBolt {
    void prepare(const Config&, const TopologyContext&) override { throw std::runtime_error("no model file"); }
    void execute(const Tuple&, BasicOutputCollector&) override {}
  };
  Bench bench;
  auto source = std::make_shared<Source>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt<Unready>("unready").shuffle_grouping("in");
  Runtime runtime(builder.build("unready"), bench.options());
  try {
    runtime.start();
    FAIL() << "start() must throw";
  } catch (const TopologyError& e) {
    EXPECT_EQ(e.component(), "unready");
    EXPECT_THAT(e.what(), testing::HasSubstr("no model file"));
  }
}

TEST(Runtime, GivesComponentsTheTopologysSettingsWithTheirOwnOverThem) {
  struct Curious : BasicBolt {
    void prepare(const Config& config, const TopologyContext& context) override {
      context.metrics->counter(config.at("both") + config.at("mine") + config.at("all"), "").add();
    }
    void execute(const Tuple&, BasicOutputCollector&) override {}
  };
  Bench bench;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(std::make_shared<Source>()));
  builder.set_bolt<Curious>("curious", 1, {{"both", "own"}, {"mine", "-mine"}}).shuffle_grouping("in");
  Runtime runtime(builder.build("settings", {{"both", "topology's"}, {"all", "-all"}}), bench.options());
  runtime.start();
  EXPECT_EQ(bench.metrics.counter("own-mine-all", "").value(), 1U);
}

TEST(Runtime, StopDrainsWhatIsUnderWay) {
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  config::Metrics metrics;
  RuntimeOptions options;
  options.threads = 2;
  options.metrics = &metrics;
  options.caller_slice = 0us;  // all but the first slice on the pool
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("pass", pass_bolt(), 3).shuffle_grouping("in");
  builder.set_bolt("out", sink_bolt(sink), 2).shuffle_grouping("pass");
  Runtime runtime(builder.build("drain"), options);
  runtime.start();
  for (int i = 0; i < 10000; ++i) source->lay(Values(i));
  source->wake();
  EXPECT_TRUE(runtime.stop(120s));
  const Snapshot snapshot = runtime.snapshot();
  EXPECT_EQ(snapshot.component("in").emitted, sink->size());
  EXPECT_EQ(source->acked().size(), sink->size());
  EXPECT_EQ(source->acked().size() + source->waiting(), 10000U);
  EXPECT_EQ(source->calls().back(), "close");
}

TEST(Runtime, StopAnswersInTimeWhenABoltNeverAcks) {
  Bench bench;
  auto options = bench.options();
  options.threads = 1;
  auto source = std::make_shared<Source>();
  std::vector<Tuple> kept;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("keeps",
                bolt([&](const Tuple& tuple, OutputCollector&, const TopologyContext&) { kept.push_back(tuple); }))
      .shuffle_grouping("in");
  Runtime runtime(builder.build("keeps"), options);
  runtime.start();
  source->put(Values(1));
  ASSERT_TRUE(eventually([&] { return runtime.idle(); }));
  EXPECT_FALSE(runtime.stop(1s));  // time for the spout to return from its last call, so that it is closed
  EXPECT_EQ(runtime.snapshot().component("in").pending, 1U);
  EXPECT_EQ(source->calls().back(), "close");
  kept.clear();
}

}  // namespace
}  // namespace iotcloud::topology::workshop
