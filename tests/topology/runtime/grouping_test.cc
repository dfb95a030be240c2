#include <algorithm>
#include <map>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::Each;
using testing::ElementsAre;

/// Runs `count` tuples (key = i % keys, value = i) from one spout to `tasks` sinks with the given grouping.
std::vector<Sink::Item> run(int count, int keys, int tasks, const std::function<void(BoltDeclarer&)>& group) {
  Bench bench;
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source, {"key", "value"}));
  BoltDeclarer declarer = builder.set_bolt("out", sink_bolt(sink), tasks);
  group(declarer);
  Runtime runtime(builder.build("grouping"), bench.options());
  runtime.start();
  for (int i = 0; i < count; ++i) source->lay(Values("key-" + std::to_string(i % keys), i));
  source->wake();
  runtime.run_until_idle();
  return sink->items;
}

std::vector<int> per_task(const std::vector<Sink::Item>& items, int tasks) {
  std::vector<int> counts(static_cast<std::size_t>(tasks), 0);
  for (const auto& item : items) ++counts[static_cast<std::size_t>(item.task)];
  return counts;
}

TEST(Grouping, ShuffleGivesEveryTaskTheSame) {
  const auto items = run(400, 10, 4, [](BoltDeclarer& out) { out.shuffle_grouping("in"); });
  EXPECT_THAT(per_task(items, 4), Each(100));
}

TEST(Grouping, NoneAndLocalOrShuffleGiveEachTupleToOneTask) {
  EXPECT_EQ(run(400, 10, 4, [](BoltDeclarer& out) { out.none_grouping("in"); }).size(), 400U);
  EXPECT_THAT(per_task(run(400, 10, 4, [](BoltDeclarer& out) { out.local_or_shuffle_grouping("in"); }), 4), Each(100));
}

TEST(Grouping, FieldsSendsAKeyToOneTaskAlwaysInOrderAndUsesAllTasks) {
  const auto items = run(2000, 100, 4, [](BoltDeclarer& out) { out.fields_grouping("in", {"key"}); });
  std::map<std::string, std::set<int>> tasks_of_key;
  std::map<std::string, std::int64_t> last;
  std::set<int> used;
  for (const auto& item : items) {
    const auto& key = std::get<std::string>(item.values[0]);
    const auto number = std::get<std::int64_t>(item.values[1]);
    tasks_of_key[key].insert(item.task);
    used.insert(item.task);
    EXPECT_TRUE(last.count(key) == 0 || last[key] < number) << key;
    last[key] = number;
  }
  EXPECT_EQ(items.size(), 2000U);
  EXPECT_EQ(tasks_of_key.size(), 100U);
  for (const auto& [key, tasks] : tasks_of_key) EXPECT_EQ(tasks.size(), 1U) << key;
  EXPECT_EQ(used.size(), 4U);
}

TEST(Grouping, PartialKeySpreadsAHotKeyOverTwoTasksEvenly) {
  const auto items = run(1000, 1, 8, [](BoltDeclarer& out) { out.partial_key_grouping("in", {"key"}); });
  auto counts = per_task(items, 8);
  std::sort(counts.rbegin(), counts.rend());
  EXPECT_THAT(counts, ElementsAre(500, 500, 0, 0, 0, 0, 0, 0));
}

TEST(Grouping, AllSendsToEveryTask) {
  const auto items = run(50, 10, 3, [](BoltDeclarer& out) { out.all_grouping("in"); });
  EXPECT_THAT(per_task(items, 3), Each(50));
}

TEST(Grouping, GlobalSendsToTheLowestTask) {
  const auto items = run(50, 10, 3, [](BoltDeclarer& out) { out.global_grouping("in"); });
  EXPECT_THAT(per_task(items, 3), ElementsAre(50, 0, 0));
}

TEST(Grouping, CustomAsksTheUsersClass) {
  struct ByLength : Grouping {
    void prepare(const TopologyContext&, const Fields& fields, std::span<const int> targets) override {
      EXPECT_EQ(fields, (Fields{"key", "value"}));
      targets_.assign(targets.begin(), targets.end());
    }
    void choose(const Values& values, std::vector<int>& chosen) override {
      const auto number = std::get<std::int64_t>(values[1]);
      if (number < 10) chosen.push_back(targets_.back());  // others go nowhere
    }
    std::vector<int> targets_;
  };
  const auto items =
      run(50, 10, 3, [](BoltDeclarer& out) { out.custom_grouping("in", [] { return std::make_unique<ByLength>(); }); });
  EXPECT_THAT(per_task(items, 3), ElementsAre(0, 0, 10));
}

TEST(Grouping, ACustomChoiceThatDoesNotReadTheStreamIsAnErrorOfTheEmitter) {
  struct Astray : Grouping {
    void prepare(const TopologyContext&, const Fields&, std::span<const int>) override {}
    void choose(const Values&, std::vector<int>& chosen) override { chosen.push_back(99); }
  };
  Bench bench;
  auto source = std::make_shared<Source>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("out", sink_bolt(std::make_shared<Sink>())).custom_grouping("in", [] {
    return std::make_unique<Astray>();
  });
  Runtime runtime(builder.build("astray"), bench.options());
  runtime.start();
  source->put(Values(1));
  runtime.run_until_idle();
  EXPECT_THAT(runtime.snapshot().component("in").last_error, testing::HasSubstr("chose task 99"));
}

TEST(Grouping, DirectGoesWhereTheEmitterSays) {
  struct Director : Bolt {
    void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
      declarer.declare_stream("orders", {"value"}, true);
    }
    void prepare(const Config&, const TopologyContext& context, OutputCollector& collector) override {
      collector_ = &collector;
      tasks_ = context.tasks_of->at("out");
    }
    void execute(const Tuple& tuple) override {
      const auto number = tuple.get<std::int64_t>("value");
      collector_->emit_direct(tasks_[static_cast<std::size_t>(number) % tasks_.size()], "orders", {&tuple, 1},
                              Values(number));
      collector_->ack(tuple);
    }
    OutputCollector* collector_ = nullptr;
    std::vector<int> tasks_;
  };
  Bench bench;
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt<Director>("director").shuffle_grouping("in");
  builder.set_bolt("out", sink_bolt(sink), 3).direct_grouping("director", "orders");
  Runtime runtime(builder.build("direct"), bench.options());
  runtime.start();
  for (int i = 0; i < 6; ++i) source->put(Values(i));
  runtime.run_until_idle();
  for (const auto& item : sink->items) EXPECT_EQ(item.task, std::get<std::int64_t>(item.values[0]) % 3);
  EXPECT_EQ(sink->size(), 6U);
  EXPECT_EQ(source->acked().size(), 6U);
}

TEST(StableHash, NeverChanges) {
  // Values of FNV-1a 64 over the kind byte and the canonical bytes, computed apart from this code.
  EXPECT_EQ(stable_hash(Value(std::string("turtle-1"))), 0x18442d14a347679fULL);
  EXPECT_EQ(stable_hash(Value(std::int64_t{42})), 0x21fdd47119083f4fULL);
  EXPECT_EQ(stable_hash(Value(-0.0)), stable_hash(Value(0.0)));
}

}  // namespace
}  // namespace iotcloud::topology::workshop
