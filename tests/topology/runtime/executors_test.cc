#include <algorithm>
#include <condition_variable>
#include <latch>
#include <map>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::HasSubstr;

/// Counts how many calls are inside at the same time.
class Crowd {
 public:
  /// From now on a call stays inside until `count` have been there together, or 20 s have passed.
  void expect(int count) {
    const std::lock_guard lock(mutex_);
    wanted_ = count;
    most_ = 0;
  }
  void pass() {
    std::unique_lock lock(mutex_);
    most_ = std::max(most_, ++inside_);
    changed_.notify_all();
    changed_.wait_for(lock, tests::patience, [this] { return most_ >= wanted_; });
    lock.unlock();
    std::this_thread::yield();  // whoever must not come in has time to do so
    lock.lock();
    --inside_;
  }
  int most() const {
    const std::lock_guard lock(mutex_);
    return most_;
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  int wanted_ = 1, inside_ = 0, most_ = 0;
};

/// in -> work (`tasks` tasks, `parallelism` executors).
Topology crowded(const std::shared_ptr<Source>& source, Crowd& crowd, int parallelism, int tasks) {
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("work", bolt([&crowd](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  crowd.pass();
                  out.ack(tuple);
                }),
                parallelism)
      .shuffle_grouping("in")
      .tasks(tasks);
  return builder.build("crowded");
}

RuntimeOptions four_threads(config::Metrics& metrics) {
  RuntimeOptions options;
  options.threads = 4;
  options.metrics = &metrics;
  return options;
}

/// Sends `tuples` through a crowded topology. \return how many calls were inside at the same time at most.
int crowd_of(Source& source, Crowd& crowd, int expected, int tuples = 60) {
  const std::size_t before = source.acked().size();
  crowd.expect(expected);
  for (int i = 0; i < tuples; ++i) source.lay(Values(i));
  source.wake();
  EXPECT_TRUE(eventually([&] { return source.acked().size() == before + static_cast<std::size_t>(tuples); }));
  return crowd.most();
}

TEST(Executors, AsManyTasksRunAtOnceAsThereAreExecutorsAndNoMore) {
  for (const int parallelism : {1, 2, 4}) {
    auto source = std::make_shared<Source>();
    Crowd crowd;
    config::Metrics metrics;
    Runtime runtime(crowded(source, crowd, parallelism, 4), four_threads(metrics));
    runtime.start();
    EXPECT_EQ(crowd_of(*source, crowd, parallelism), parallelism);
    EXPECT_EQ(runtime.snapshot().parallelism.at("work"), parallelism);
  }
}

TEST(Executors, ChangeWhileTheTopologyRuns) {
  auto source = std::make_shared<Source>();
  Crowd crowd;
  config::Metrics metrics;
  Runtime runtime(crowded(source, crowd, 1, 4), four_threads(metrics));
  runtime.start();
  EXPECT_EQ(crowd_of(*source, crowd, 1), 1);
  for (const int parallelism : {4, 2, 1, 3}) {
    ASSERT_TRUE(eventually([&] { return runtime.idle(); }));
    runtime.rebalance("work", parallelism);
    EXPECT_EQ(crowd_of(*source, crowd, parallelism), parallelism);
  }
}

TEST(Executors, ARebalanceUnderLoadLosesNothingAndKeepsTheOrderOfEachKey) {
  constexpr int keys = 32, each = 400;
  auto source = std::make_shared<Source>();
  std::mutex mutex;
  std::map<std::int64_t, std::int64_t> last_of_key;
  std::map<std::int64_t, int> task_of_key;
  int out_of_order = 0, moved = 0;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source, {"key", "number"}));
  builder
      .set_bolt("count", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext& context) {
                  const auto key = tuple.get<std::int64_t>("key"), number = tuple.get<std::int64_t>("number");
                  {
                    const std::lock_guard lock(mutex);
                    if (number != last_of_key[key] + 1) ++out_of_order;
                    last_of_key[key] = number;
                    if (task_of_key.try_emplace(key, context.task).first->second != context.task) ++moved;
                  }
                  out.ack(tuple);
                }),
                4)
      .fields_grouping("in", {"key"})
      .tasks(8);
  config::Metrics metrics;
  RuntimeOptions options;
  options.threads = 3;
  options.metrics = &metrics;
  options.mailbox_capacity = 32;
  Runtime runtime(builder.build("rebalanced"), options);
  runtime.start();
  for (int number = 1; number <= each; ++number) {
    for (int key = 0; key < keys; ++key) source->lay(Values(key, number));
  }
  source->wake();
  std::mt19937 random(7);
  while (source->acked().size() < keys * each / 2) {
    runtime.rebalance("count", std::uniform_int_distribution(1, 8)(random));
    std::this_thread::yield();
  }
  runtime.rebalance("count", 1);
  EXPECT_TRUE(eventually([&] { return source->acked().size() == std::size_t{keys} * each; }));
  const std::lock_guard lock(mutex);
  EXPECT_EQ(out_of_order, 0);
  EXPECT_EQ(moved, 0);
}

TEST(Executors, WhatIsNotPossibleIsRefusedAndSaysWhatIs) {
  auto source = std::make_shared<Source>();
  Crowd crowd;
  Bench bench;
  Runtime runtime(crowded(source, crowd, 2, 4), bench.options());
  const auto message_of = [&](const std::string& component, int parallelism) -> std::string {
    try {
      runtime.rebalance(component, parallelism);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "accepted";
  };
  EXPECT_THAT(message_of("work", 5), HasSubstr("it has 4 tasks, so 1 to 4 are possible"));
  EXPECT_THAT(message_of("work", 0), HasSubstr("1 to 4"));
  EXPECT_THAT(message_of("wrok", 1), HasSubstr("it has: in, work"));
  EXPECT_EQ(message_of("work", 4), "accepted");
}

TEST(Executors, FewerTasksThanExecutorsAreRefused) {
  TopologyBuilder builder;
  auto declarer = builder.set_bolt("work", pass_bolt(), 4);
  EXPECT_THROW(declarer.tasks(3), TopologyError);
  EXPECT_NO_THROW(declarer.tasks(4));
}

TEST(Executors, EachSpoutTaskHasItsOwnLimitOfTuplesUnderWay) {
  auto narrow = std::make_shared<Source>(), wide = std::make_shared<Source>();
  std::vector<Tuple> kept;
  TopologyBuilder builder;
  builder.set_spout("narrow", source_spout(narrow)).max_pending(2);
  builder.set_spout("wide", source_spout(wide));
  builder
      .set_bolt("keep",
                bolt([&](const Tuple& tuple, OutputCollector&, const TopologyContext&) { kept.push_back(tuple); }))
      .shuffle_grouping("narrow")
      .shuffle_grouping("wide");
  Bench bench;
  auto options = bench.options();
  options.max_spout_pending = 5;
  Runtime runtime(builder.build("pending"), options);
  runtime.start();
  for (const auto& source : {narrow, wide}) {
    for (int i = 0; i < 20; ++i) source->lay(Values(i));
    source->wake();
  }
  runtime.run_until_idle();
  EXPECT_EQ(runtime.snapshot().component("narrow").pending, 2U);
  EXPECT_EQ(runtime.snapshot().component("wide").pending, 5U);
  kept.clear();
}

TEST(Executors, ATaskThatDoesNotReturnIsNamed) {
  auto source = std::make_shared<Source>();
  std::latch may_end(1);
  std::mutex mutex;
  std::vector<std::string> reports;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("stuck", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  may_end.wait();
                  out.ack(tuple);
                }))
      .shuffle_grouping("in");
  config::Metrics metrics;
  RuntimeOptions options;
  options.threads = 2;
  options.metrics = &metrics;
  options.hang_after = 20ms;
  options.on_error = [&](const std::string& component, int task, const std::string& text) {
    const std::lock_guard lock(mutex);
    // On a busy machine another task may wait for a core for as long.
    if (component == "stuck") reports.push_back(component + "/" + std::to_string(task) + ": " + text);
  };
  Runtime runtime(builder.build("hanging"), options);
  runtime.start();
  std::jthread reader([&] { source->put(Values(1)); });
  EXPECT_TRUE(eventually([&] {
    const std::lock_guard lock(mutex);
    return !reports.empty();
  }));
  EXPECT_TRUE(eventually([&] { return runtime.longest_call().component == "stuck"; }));
  EXPECT_EQ(runtime.longest_call().task, 2);
  EXPECT_GE(runtime.longest_call().age, options.hang_after);
  may_end.count_down();
  EXPECT_TRUE(eventually([&] { return source->acked().size() == 1; })) << "it is reported, not killed";
  const std::lock_guard lock(mutex);
  ASSERT_EQ(reports.size(), 1U) << "once for each time that it hangs";
  EXPECT_THAT(reports.front(), HasSubstr("stuck/2: does not return from user code"));
  EXPECT_THAT(runtime.snapshot().component("stuck").last_error, HasSubstr("does not return"));
}

TEST(Executors, WhoIsToldOfAHangingTaskMayChangeTheParallelism) {
  auto source = std::make_shared<Source>();
  std::latch may_end(1);
  std::atomic<Runtime*> there{nullptr};
  std::atomic<bool> changed{false};
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("stuck", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  may_end.wait();
                  out.ack(tuple);
                }))
      .shuffle_grouping("in")
      .tasks(4);
  config::Metrics metrics;
  RuntimeOptions options;
  options.threads = 2;
  options.metrics = &metrics;
  options.hang_after = 100ms;  // long enough that the tasks behind the one that hangs stand aside by then
  options.on_error = [&](const std::string& component, int, const std::string&) {
    if (component != "stuck" || there.load() == nullptr || changed) return;
    there.load()->rebalance("stuck", 4);
    changed = true;
  };
  Runtime runtime(builder.build("hanging"), options);
  there = &runtime;
  runtime.start();
  for (int i = 0; i < 8; ++i) source->lay(Values(i));
  std::jthread reader([&] { source->wake(); });
  EXPECT_TRUE(eventually([&] { return changed.load(); })) << "the tasks that stood aside could not be handed on";
  may_end.count_down();
  EXPECT_TRUE(eventually([&] { return source->acked().size() == 8; }));
}

TEST(Executors, ATaskThatIsInUserCodeWhenTheRuntimeStopsIsCleanedUpWhenItReturns) {
  class Slow : public Bolt {
   public:
    Slow(std::latch& entered, std::latch& may_end, std::atomic<bool>& cleaned)
        : entered_(entered), may_end_(may_end), cleaned_(cleaned) {}
    void prepare(const Config&, const TopologyContext&, OutputCollector&) override {}
    void execute(const Tuple&) override {
      entered_.count_down();
      may_end_.wait();
    }
    void cleanup() override { cleaned_ = true; }

   private:
    std::latch &entered_, &may_end_;
    std::atomic<bool>& cleaned_;
  };
  auto source = std::make_shared<Source>();
  std::latch entered(1), may_end(1);
  std::atomic<bool> cleaned{false};
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("slow", [&] { return std::make_unique<Slow>(entered, may_end, cleaned); }).shuffle_grouping("in");
  config::Metrics metrics;
  RuntimeOptions options;
  options.metrics = &metrics;
  auto runtime = std::make_unique<Runtime>(builder.build("slow"), options);
  runtime->start();
  source->lay(Values(1));
  std::jthread reader([&] { source->wake(); });
  entered.wait();
  EXPECT_FALSE(runtime->stop(0ms));
  EXPECT_FALSE(cleaned);
  may_end.count_down();
  runtime.reset();
  EXPECT_TRUE(cleaned);
}

}  // namespace
}  // namespace iotcloud::topology::workshop
