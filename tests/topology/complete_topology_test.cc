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
