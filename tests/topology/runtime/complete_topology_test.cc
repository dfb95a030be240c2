#include <map>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::ElementsAre;

/// Counts words; tells all counts at each tick.
struct WordCount : Bolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"word", "count"}); }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  void execute(const Tuple& tuple) override {
    if (tuple.is_tick()) {
      for (const auto& [word, count] : counts_) collector_->emit(Values(word, count));
    } else {
      ++counts_[tuple.get<std::string>("word")];
      collector_->ack(tuple);
    }
  }
  std::map<std::string, std::int64_t> counts_;
  OutputCollector* collector_ = nullptr;
};

struct Split : BasicBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"word"}); }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    std::istringstream words(tuple.get<std::string>("line"));
    for (std::string word; words >> word;) collector.emit(Values(word));
  }
};

TEST(CompleteTopology, RunsFixedInputToTheEndInSimulatedTime) {
  TopologyBuilder builder;
  builder.set_spout("lines", source_spout(std::make_shared<Source>(), {"line"}), 2);
  builder.set_bolt<Split>("split", 2).shuffle_grouping("lines");
  builder.set_bolt<WordCount>("count", 1).fields_grouping("split", {"word"}).tick(1s);
  CompleteOptions options;
  options.inputs["lines"] = {Values("a b a"), Values("b c"), Values("a")};
  options.run_for = 1s;
  const CompletedTopology result = complete_topology(builder.build("words"), options);
  EXPECT_EQ(result.tuples("lines").size(), 3U);
  EXPECT_EQ(result.tuples("split").size(), 6U);
  EXPECT_THAT(result.tuples("count"), ElementsAre(ElementsAre(Value("a"), Value(std::int64_t{3})),
                                                  ElementsAre(Value("b"), Value(std::int64_t{2})),
                                                  ElementsAre(Value("c"), Value(std::int64_t{1}))));
  EXPECT_EQ(result.snapshot.component("lines").acked, 3U);
  EXPECT_EQ(result.snapshot.tasks.size(), 5U);
}

/// Sends numbers to one task of "sink" on a direct stream, and says so on another one that nobody reads.
struct DirectBolt : Bolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare_stream("to-one", {"number"}, true);
    declarer.declare_stream("unread", {"number"});
  }
  void prepare(const Config&, const TopologyContext& context, OutputCollector& collector) override {
    collector_ = &collector;
    target_ = context.tasks_of->at("sink").back();
  }
  void execute(const Tuple& tuple) override {
    collector_->emit_direct(target_, "to-one", {&tuple, 1}, Values(tuple.at(0)));
    collector_->emit_to("unread", {&tuple, 1}, Values(tuple.at(0)));
    collector_->ack(tuple);
  }
  OutputCollector* collector_ = nullptr;
  int target_ = 0;
};
struct Discarding : BasicBolt {
  void execute(const Tuple&, BasicOutputCollector&) override {}
};

TEST(CompleteTopology, CollectsDirectStreamsAndThoseThatNobodyReads) {
  TopologyBuilder builder;
  builder.set_spout("numbers", source_spout(std::make_shared<Source>(), {"number"}));
  builder.set_bolt<DirectBolt>("director").shuffle_grouping("numbers");
  builder.set_bolt<Discarding>("sink", 2).direct_grouping("director", "to-one");
  CompleteOptions options;
  options.inputs["numbers"] = {Values(1), Values(2)};
  const CompletedTopology result = complete_topology(builder.build("t"), options);
  const auto both = ElementsAre(ElementsAre(Value(std::int64_t{1})), ElementsAre(Value(std::int64_t{2})));
  EXPECT_THAT(result.tuples("director", "to-one"), both);
  EXPECT_THAT(result.tuples("director", "unread"), both);
  EXPECT_EQ(result.emitted.size(), 6U);  // nothing of the sink
  EXPECT_EQ(result.snapshot.component("sink").executed, 2U);
  EXPECT_EQ(result.snapshot.component("numbers").acked, 2U);
}

TEST(CompleteTopology, EmitsTimedInputAtItsTimeBetweenTheSteps) {
  TopologyBuilder builder;
  builder.set_spout("words", source_spout(std::make_shared<Source>(), {"word"}));
  builder.set_bolt<WordCount>("count").fields_grouping("words", {"word"}).tick(10ms);
  CompleteOptions options;
  options.timed_inputs["words"] = {{25ms, Values("c")}, {0ms, Values("a")}, {5ms + 300us, Values("b")}};
  options.run_for = 5ms;
  const CompletedTopology result = complete_topology(builder.build("t"), options);
  std::vector<std::pair<std::string, std::chrono::nanoseconds>> seen;
  for (const auto& tuple : result.emitted) {
    seen.emplace_back(tuple.component + " " + std::get<std::string>(tuple.values[0]), tuple.at);
  }
  EXPECT_THAT(seen, ElementsAre(std::pair("words a", 0ms), std::pair("words b", 5ms + 300us),
                                std::pair("count a", 10ms), std::pair("count b", 10ms), std::pair("count a", 20ms),
                                std::pair("count b", 20ms), std::pair("words c", 25ms), std::pair("count a", 30ms),
                                std::pair("count b", 30ms), std::pair("count c", 30ms)));
}

TEST(SimulatedTopology, IsFedAndMovedThroughTimeStepByStep) {
  TopologyBuilder builder;
  builder.set_spout("words", source_spout(std::make_shared<Source>(), {"word"}), 2);
  builder.set_bolt<WordCount>("count").fields_grouping("words", {"word"}).tick(1s);
  SimulatedTopology simulated(builder.build("t"), {.inputs = {"words"}, .message_timeout = 30s, .step = 100ms});
  simulated.put("words", Values("a"));
  EXPECT_EQ(simulated.snapshot().component("words").acked, 1U);
  simulated.advance(999ms);
  EXPECT_TRUE(simulated.tuples("count").empty());
  simulated.put("words", Values("a"));
  simulated.advance(1ms);
  EXPECT_EQ(simulated.time(), 1s);
  EXPECT_THAT(simulated.tuples("count"), ElementsAre(ElementsAre(Value("a"), Value(std::int64_t{2}))));
  EXPECT_THROW(simulated.put("count", Values("a")), std::invalid_argument);
}

TEST(SimulatedTopology, FailsTreesThatTakeTooLong) {
  struct Keeper : Bolt {
    void prepare(const Config&, const TopologyContext&, OutputCollector&) override {}
    void execute(const Tuple& tuple) override { kept_ = tuple; }
    void cleanup() override { kept_ = {}; }
    Tuple kept_;
  };
  TopologyBuilder builder;
  builder.set_spout("words", source_spout(std::make_shared<Source>(), {"word"}));
  builder.set_bolt<Keeper>("keep").shuffle_grouping("words");
  SimulatedTopology simulated(builder.build("t"), {.inputs = {"words"}, .message_timeout = 10s, .step = 100ms});
  simulated.put("words", Values("a"));
  simulated.advance(9900ms);
  EXPECT_EQ(simulated.snapshot().component("words").timed_out, 0U);
  simulated.advance(1500ms);
  EXPECT_EQ(simulated.snapshot().component("words").timed_out, 1U);
}

TEST(SimulatedTopology, LogsFailedTuplesByCauseOnceAMinuteAtMost) {
  struct Faulty : Bolt {
    void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override {
      collector_ = &collector;
    }
    void execute(const Tuple& tuple) override {
      const auto& word = tuple.get<std::string>("word");
      if (word == "keep") kept_.push_back(tuple);
      if (word == "fail") collector_->fail(tuple);
    }
    void cleanup() override { kept_.clear(); }
    OutputCollector* collector_ = nullptr;
    std::vector<Tuple> kept_;
  };
  TopologyBuilder builder;
  builder.set_spout("words", source_spout(std::make_shared<Source>(), {"word"}));
  builder.set_bolt<Faulty>("faulty").shuffle_grouping("words");
  testing::internal::CaptureStderr();
  {
    SimulatedTopology simulated(builder.build("t"), {.inputs = {"words"}, .message_timeout = 10s, .step = 100ms});
    simulated.put("words", Values("fail"));
    simulated.advance(2s);
    simulated.put("words", {Values("keep"), Values("keep"), Values("drop"), Values("fail")});
    simulated.advance(70s);
    simulated.put("words", Values("fail"));  // told when the topology ends
  }
  std::istringstream log(testing::internal::GetCapturedStderr());
  std::vector<std::string> lines;
  for (std::string line; std::getline(log, line);) {
    if (line.find("tuples failed") != std::string::npos)
      lines.push_back(line.substr(line.find("t: component words, task 1: ")));
  }
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_THAT(lines[0], testing::HasSubstr("1 tuples failed: 1 failed by a bolt, which threw or called fail()"));
  EXPECT_THAT(
      lines[1],
      testing::HasSubstr("4 tuples failed: 2 not done within the message time-out of 10000 ms (a bolt keeps them for "
                         "longer, or they wait in full mailboxes), 1 failed by a bolt, which threw or called fail(), 1 "
                         "dropped by a bolt without ack or fail"));
  EXPECT_THAT(lines[2], testing::HasSubstr("1 tuples failed: "));
}

TEST(CompleteTopology, RefusesInputForWhatIsNoSpout) {
  TopologyBuilder builder;
  builder.set_spout("lines", source_spout(std::make_shared<Source>(), {"line"}));
  builder.set_bolt<Split>("split").shuffle_grouping("lines");
  CompleteOptions options;
  options.inputs["split"] = {};
  EXPECT_THROW(complete_topology(builder.build("words"), options), TopologyError);
}

}  // namespace
}  // namespace iotcloud::topology::workshop
