// Deadlines and keep_last: what a robot needs.
#include <map>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

/// Hands tuples on, each call of which takes `period`.
BoltFactory slow_bolt(SimulatedClock& clock, std::chrono::milliseconds period) {
  return bolt(
      [&clock, period](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
        clock.advance(period);
        out.emit(tuple, Values(tuple.at(0)));
        out.ack(tuple);
      },
      {"value"});
}

/// A spout "in", a sink, and simulated time; a test adds what is between them.
struct Line {
  Line() { builder.set_spout("in", source_spout(source)); }
  void start() {
    runtime = std::make_unique<Runtime>(builder.build("line"), bench.options());
    runtime->start();
  }
  void put(int value) {
    source->put(Values(value));
    runtime->run_until_idle();
  }

  Bench bench;
  std::shared_ptr<Source> source = std::make_shared<Source>();
  std::shared_ptr<Sink> sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  std::unique_ptr<Runtime> runtime;
};

TEST(Deadline, ALateTupleIsNotExecutedButCountedAndAcked) {
  Line line;
  line.builder
      .set_bolt("takes", bolt(
                             [&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                               line.bench.clock.advance(std::chrono::milliseconds(tuple.get<std::int64_t>("value")));
                               out.emit(tuple, Values(tuple.at(0)));
                               out.ack(tuple);
                             },
                             {"value"}))
      .shuffle_grouping("in");
  line.builder.set_bolt("out", sink_bolt(line.sink)).shuffle_grouping("takes").deadline(50ms);
  line.start();
  for (const int milliseconds : {10, 60, 49, 51}) line.put(milliseconds);
  EXPECT_THAT(line.sink->numbers(), ElementsAre(10, 49));
  const auto out = line.runtime->snapshot().component("out");
  EXPECT_EQ(out.late, 2U);
  EXPECT_EQ(out.executed, 2U);
  EXPECT_EQ(line.source->acked().size(), 4U);
  EXPECT_THAT(line.source->failed(), IsEmpty());
}

TEST(Deadline, AFreshTupleIsExecuted) {
  Line line;
  line.builder.set_bolt("out", sink_bolt(line.sink)).shuffle_grouping("in").deadline(50ms);
  line.start();
  for (int i = 1; i <= 3; ++i) {
    line.bench.clock.advance(10s);
    line.put(i);
  }
  EXPECT_THAT(line.sink->numbers(), ElementsAre(1, 2, 3));
  EXPECT_EQ(line.runtime->snapshot().component("out").late, 0U);
}

/// Takes `period` between being asked for its only tuple and emitting it.
class SlowSpout final : public Spout {
 public:
  SlowSpout(SimulatedClock& clock, std::chrono::milliseconds period) : clock_(clock), period_(period) {}
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"value"}); }
  void open(const Config&, const TopologyContext&, SpoutOutputCollector& collector) override {
    collector_ = &collector;
  }
  bool next_tuple() override {
    if (std::exchange(emitted_, true)) return false;
    clock_.advance(period_);
    collector_->emit(Values(1));
    return false;
  }

 private:
  SimulatedClock& clock_;
  const std::chrono::milliseconds period_;
  bool emitted_ = false;
  SpoutOutputCollector* collector_ = nullptr;
};

TEST(Deadline, CountsFromWhenTheSpoutWasAsked) {
  for (const auto& [period, late] : {std::pair(49ms, 0U), std::pair(51ms, 1U)}) {
    Bench bench;
    auto sink = std::make_shared<Sink>();
    TopologyBuilder builder;
    builder.set_spout("in", [&bench, period = period] { return std::make_unique<SlowSpout>(bench.clock, period); });
    builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("in").deadline(50ms);
    Runtime runtime(builder.build("asked"), bench.options());
    runtime.start();
    runtime.run_until_idle();
    EXPECT_EQ(runtime.snapshot().component("out").late, late);
    EXPECT_EQ(sink->numbers().size(), 1U - late);
  }
}

TEST(Deadline, ALateTupleGoesToTheLateStreamWithItsValuesAndItsTree) {
  auto late = std::make_shared<Sink>();
  std::vector<Tuple> held;
  Line line;
  line.builder.set_bolt("slow", slow_bolt(line.bench.clock, 100ms)).shuffle_grouping("in");
  line.builder.set_bolt("out", sink_bolt(line.sink)).shuffle_grouping("slow").deadline(50ms, "late");
  line.builder
      .set_bolt("archive", bolt([&](const Tuple& tuple, OutputCollector&, const TopologyContext& context) {
                  late->add(tuple, context.task);
                  held.push_back(tuple);
                }))
      .shuffle_grouping("out", "late");
  line.start();
  line.put(7);
  EXPECT_THAT(line.sink->numbers(), IsEmpty());
  EXPECT_THAT(late->numbers(), ElementsAre(7));
  EXPECT_EQ(held.at(0).fields().list(), "value");
  EXPECT_THAT(line.source->acked(), IsEmpty()) << "it is anchored: the archive has not acked";
  held.clear();
}

TEST(Deadline, TheShorterOneOfInputAndComponentCounts) {
  Line line;
  auto mild = std::make_shared<Sink>();
  line.builder.set_bolt("slow", slow_bolt(line.bench.clock, 30ms)).shuffle_grouping("in");
  line.builder.set_bolt("strict", sink_bolt(line.sink)).shuffle_grouping("slow").input_deadline(20ms).deadline(50ms);
  line.builder.set_bolt("mild", sink_bolt(mild)).shuffle_grouping("slow").input_deadline(200ms);
  line.start();
  line.put(1);
  EXPECT_THAT(line.sink->numbers(), IsEmpty());
  EXPECT_THAT(mild->numbers(), ElementsAre(1));
}

TEST(Deadline, EachOfSeveralInputsHasItsLateTuplesCounted) {
  Line line;
  line.builder.set_bolt("slow", slow_bolt(line.bench.clock, 60ms)).shuffle_grouping("in");
  line.builder.set_bolt("out", sink_bolt(line.sink)).shuffle_grouping("in").shuffle_grouping("slow").deadline(50ms);
  line.start();
  for (int i = 1; i <= 3; ++i) line.put(i);
  const auto out = line.runtime->snapshot().component("out");
  ASSERT_EQ(out.inputs.size(), 2U);
  EXPECT_EQ(out.inputs[0].late + out.inputs[1].late, out.late);
  EXPECT_EQ(out.inputs[0].executed + out.inputs[1].executed, out.executed);
  EXPECT_EQ(out.inputs[1].from, "slow");
  EXPECT_EQ(out.inputs[1].late, 3U);
  EXPECT_EQ(out.inputs[1].acked, 3U) << "they are acked all the same";
}

TEST(Deadline, CountsFromTheSpoutAlsoThroughABoltThatDoesNotAnchor) {
  Line line;
  line.builder
      .set_bolt("slow", bolt(
                            [&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                              line.bench.clock.advance(60ms);
                              out.emit(Values(tuple.at(0)));
                              out.ack(tuple);
                            },
                            {"value"}))
      .shuffle_grouping("in");
  line.builder.set_bolt("out", sink_bolt(line.sink)).shuffle_grouping("slow").deadline(50ms);
  line.start();
  line.put(1);
  EXPECT_THAT(line.sink->numbers(), IsEmpty());
}

TEST(Deadline, ALateStreamNeedsInputsThatAgreeAndANameOfItsOwn) {
  const auto message_of = [](const Fields& second, const std::string& name) -> std::string {
    TopologyBuilder builder;
    builder.set_spout("a", source_spout(std::make_shared<Source>(), {"value"}));
    builder.set_spout("b", source_spout(std::make_shared<Source>(), second));
    builder.set_bolt("out", pass_bolt()).shuffle_grouping("a").shuffle_grouping("b").deadline(1ms, name);
    try {
      builder.build("late");
    } catch (const TopologyError& error) {
      return error.what();
    }
    return "built";
  };
  EXPECT_EQ(message_of({"value"}, "late"), "built");
  EXPECT_THAT(message_of({"other"}, "late"), HasSubstr("needs inputs of the same fields; b differs from a"));
  EXPECT_THAT(message_of({"value"}, "default"), HasSubstr("a name of its own"));
}

/// in -> burst -> several that keep the newest: one call emits a1 b1 a2 c1 b2 a3, so that they reach a mailbox
/// together.
struct Burst : Line {
  Burst() {
    builder
        .set_bolt("burst", bolt(
                               [](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                                 for (const char* text : {"a1", "b1", "a2", "c1", "b2", "a3"}) {
                                   out.emit(tuple, Values(std::string(1, text[0]), text));
                                 }
                                 out.ack(tuple);
                               },
                               {"key", "text"}))
        .shuffle_grouping("in");
  }
  /// A bolt that notes what it gets.
  BoltDeclarer add(const std::string& id) {
    return builder.set_bolt(id, bolt([this, id](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                              got[id].push_back(tuple.get<std::string>("text"));
                              out.ack(tuple);
                            }));
  }
  void run() {
    start();
    put(1);
  }
  std::uint64_t superseded(const std::string& id) const { return runtime->snapshot().component(id).superseded; }

  std::map<std::string, std::vector<std::string>> got;
};

TEST(KeepLast, ANewerTupleOfAKeyTakesThePlaceOfTheOneThatWaits) {
  Burst burst;
  burst.add("newest").shuffle_grouping("burst").keep_last(1, {"key"});
  burst.run();
  EXPECT_THAT(burst.got["newest"], ElementsAre("a3", "b2", "c1"));
  EXPECT_EQ(burst.superseded("newest"), 3U);
  EXPECT_THAT(burst.source->acked(), ElementsAre(1U)) << "superseded tuples do not hold their tree up";
  EXPECT_EQ(burst.runtime->snapshot().component("newest").queue_depth, 0U);
}

TEST(KeepLast, KeepsAsManyAsWereAskedForInOrder) {
  Burst burst;
  burst.add("two").shuffle_grouping("burst").keep_last(2, {"key"});
  burst.run();
  EXPECT_THAT(burst.got["two"], ElementsAre("a2", "b1", "a3", "c1", "b2"));
  EXPECT_EQ(burst.superseded("two"), 1U);
}

TEST(KeepLast, WithoutAKeyTheWholeInputIsOne) {
  Burst burst;
  burst.add("one").shuffle_grouping("burst").keep_last();
  burst.run();
  EXPECT_THAT(burst.got["one"], ElementsAre("a3"));
}

TEST(KeepLast, TheGroupingsKeyIsTheKeyUnlessAnotherIsNamed) {
  Burst burst;
  burst.add("grouped").fields_grouping("burst", {"key"}).keep_last();
  burst.add("named").fields_grouping("burst", {"key"}).keep_last(1, {"text"});
  burst.run();
  EXPECT_THAT(burst.got["grouped"], ElementsAre("a3", "b2", "c1"));
  EXPECT_THAT(burst.got["named"], ElementsAre("a1", "b1", "a2", "c1", "b2", "a3"));
}

TEST(KeepLast, LeavesOtherInputsAlone) {
  Burst burst;
  burst.builder.set_bolt("again", pass_bolt({"key", "text"})).shuffle_grouping("burst");
  burst.add("mixed").shuffle_grouping("burst").shuffle_grouping("again").keep_last();
  burst.run();
  EXPECT_EQ(burst.got["mixed"].size() + burst.superseded("mixed"), 12U);
  EXPECT_GE(burst.got["mixed"].size(), 7U) << "six of one, at least one of the other";
}

TEST(KeepLast, AKeyFieldThatIsNotThereIsRefused) {
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(std::make_shared<Source>(), {"key"}));
  builder.set_bolt("out", pass_bolt()).shuffle_grouping("in").keep_last(1, {"colour"});
  EXPECT_THROW(builder.build("conflated"), TopologyError);
  TopologyBuilder without_input;
  auto declarer = without_input.set_bolt("out", pass_bolt());
  EXPECT_THROW(declarer.keep_last(), TopologyError);
}

}  // namespace
}  // namespace iotcloud::topology::workshop
