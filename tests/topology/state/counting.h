#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/tests/topology/workshop.h>
#include <iotcloud/topology/state/stateful_bolt.h>

namespace iotcloud::topology::workshop {

/// Counts its words. "!" throws away nothing but fails; emits word and count.
struct Count : StatefulBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override { declarer.declare({"word", "count"}); }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { out_ = &collector; }
  void init_state(KeyValueState& state) override { state_ = &state; }
  void execute(const Tuple& tuple) override {
    const auto& word = tuple.get<std::string>("value");
    if (word == "!") {
      out_->fail(tuple);
      return;
    }
    state_->put_int(word, state_->get_int(word) + 1);
    out_->emit(tuple, Values(word, state_->get_int(word)));
    out_->ack(tuple);
  }
  OutputCollector* out_ = nullptr;
  KeyValueState* state_ = nullptr;
};

/// A topology with a bolt that counts, on a clock that the test moves.
struct Counting {
  explicit Counting(BoltFactory bolt, const Config& config = {}, int tasks = 1) {
    TopologyBuilder builder;
    builder.set_spout("in", source_spout(source));
    builder.set_bolt("count", std::move(bolt), tasks, config).fields_grouping("in", {"value"});
    builder.set_bolt("sink", sink_bolt(sink)).global_grouping("count");
    runtime.emplace(builder.build("t"), bench.options());
    runtime->start();
    runtime->run_until_idle();
  }
  void put(const std::string& word) {
    source->put(Values(word));
    runtime->run_until_idle();
  }
  void pass(std::chrono::milliseconds time) {
    bench.clock.advance(time);
    runtime->run_due_timers();
    runtime->run_until_idle();
  }
  /// word=count of all that was emitted.
  std::vector<std::string> seen() const {
    std::vector<std::string> list;
    for (const auto& item : sink->items) {
      list.push_back(std::get<std::string>(item.values[0]) + "=" +
                     std::to_string(std::get<std::int64_t>(item.values[1])));
    }
    return list;
  }
  Bench bench;
  std::shared_ptr<Source> source = std::make_shared<Source>();
  std::shared_ptr<Sink> sink = std::make_shared<Sink>();
  std::optional<Runtime> runtime;
};

/// Runs one topology after the other, each with its own number of tasks and all on one store: each counts eight words
/// twice, from where the one before was. \param checkpoint the time after which the bolt writes its state
inline void expect_counts_to_go_on(const BoltFactory& bolt, const Config& config,
                                   std::chrono::milliseconds checkpoint) {
  const std::vector<std::string> words{"a", "b", "c", "d", "e", "f", "g", "h"};
  int times = 0;
  for (const int tasks : {2, 3, 2, 1, 3}) {
    Counting counting(bolt, config, tasks);
    std::vector<std::string> wanted;
    for (int i = 0; i < 2; ++i) {
      ++times;
      for (const std::string& word : words) {
        counting.put(word);
        wanted.push_back(word + "=" + std::to_string(times));
      }
      counting.pass(checkpoint);
    }
    EXPECT_THAT(counting.seen(), testing::UnorderedElementsAreArray(wanted)) << tasks << " tasks";
    EXPECT_EQ(counting.source->acked().size(), 2 * words.size());
  }
}

}  // namespace iotcloud::topology::workshop
