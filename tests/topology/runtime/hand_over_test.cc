// A receiver that is idle gets its tuples without its mailbox, and runs next on the emitter's thread. What is promised
// of edges, queues and time holds all the same.
#include <algorithm>
#include <latch>
#include <map>
#include <mutex>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::ElementsAre;

RuntimeOptions with_threads(unsigned threads, config::Metrics& metrics) {
  RuntimeOptions options;
  options.threads = threads;
  options.metrics = &metrics;
  return options;
}

/// Checks that the numbers of each key come one after the other.
class Order {
 public:
  void see(const Tuple& tuple) {
    const auto key = tuple.get<std::int64_t>("key"), number = tuple.get<std::int64_t>("number");
    const std::lock_guard lock(mutex_);
    if (number != std::exchange(last_[key], number) + 1) ++broken_;
  }
  int broken() const {
    const std::lock_guard lock(mutex_);
    return broken_;
  }

 private:
  mutable std::mutex mutex_;
  std::map<std::int64_t, std::int64_t> last_;
  int broken_ = 0;
};

/// Passes a key and its number on, and sees their order.
BoltFactory ordered_bolt(const std::shared_ptr<Order>& order) {
  return bolt(
      [order](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
        if (tuple.is_tick()) return;
        order->see(tuple);
        out.emit(tuple, Values(tuple.at(0), tuple.at(1)));
        out.ack(tuple);
      },
      {"key", "number"});
}

/// Two spouts, four threads that wake them, three of the pool, small mailboxes, ticks and rebalances.
TEST(HandOver, TheOrderOfEachEdgeHoldsWhoeverRunsTheReceivers) {
  constexpr int wakers = 4, each = 1500;
  const auto first = std::make_shared<Order>(), second = std::make_shared<Order>(), last = std::make_shared<Order>();
  const std::vector<std::shared_ptr<Source>> sources{std::make_shared<Source>(), std::make_shared<Source>()};
  const Fields fields{"key", "number"};
  TopologyBuilder builder;
  builder.set_spout("a", source_spout(sources[0], fields));
  builder.set_spout("b", source_spout(sources[1], fields));
  builder.set_bolt("first", ordered_bolt(first), 2)
      .tasks(3)
      .fields_grouping("a", {"key"})
      .fields_grouping("b", {"key"})
      .tick(1ms);
  builder.set_bolt("second", ordered_bolt(second), 2).fields_grouping("first", {"key"});
  // One task that both components feed, and that gets each number twice: by an edge of its own it is in order.
  builder.set_bolt("last", ordered_bolt(last)).global_grouping("second");
  builder.set_bolt("end", sink_bolt(std::make_shared<Sink>())).shuffle_grouping("last").shuffle_grouping("first");
  config::Metrics metrics;
  auto options = with_threads(3, metrics);
  options.mailbox_capacity = 16;
  options.caller_slice = 50us;
  Runtime runtime(builder.build("ordered"), options);
  runtime.start();
  std::atomic<bool> done{false};
  std::jthread changes([&] {
    for (int i = 0; !done; ++i) {
      runtime.rebalance("first", 1 + i % 3);
      std::this_thread::yield();
    }
  });
  {
    std::vector<std::jthread> threads;
    for (int key = 0; key < wakers; ++key) {
      threads.emplace_back([&, key] {
        for (int number = 1; number <= each; ++number)
          sources[static_cast<std::size_t>(key % 2)]->put(Values(key, number));
      });
    }
  }
  EXPECT_TRUE(eventually(
      [&] { return sources[0]->acked().size() + sources[1]->acked().size() == std::size_t{wakers} * each; }));
  done = true;
  changes.join();
  EXPECT_TRUE(runtime.stop(120s));
  for (const auto& order : {first, second, last}) EXPECT_EQ(order->broken(), 0);
  EXPECT_EQ(runtime.snapshot().component("end").executed, std::size_t{2} * wakers * each);
}

TEST(HandOver, ABoltThatDoesNotReturnHoldsUpNeitherItsSpoutNorWhatItsNeighboursRead) {
  auto source = std::make_shared<Source>(), other = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  std::latch may_end(1);
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_spout("other", source_spout(other));
  builder.set_bolt("pass", pass_bolt()).shuffle_grouping("in");
  builder
      .set_bolt("stuck", bolt(
                             [&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                               may_end.wait();
                               out.emit(tuple, Values(tuple.at(0)));
                               out.ack(tuple);
                             },
                             {"value"}))
      .shuffle_grouping("pass");
  builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("pass").shuffle_grouping("other").shuffle_grouping("stuck");
  config::Metrics metrics;
  auto options = with_threads(2, metrics);
  options.hang_after = 20ms;
  Runtime runtime(builder.build("stuck"), options);
  runtime.start();
  std::jthread reader([&] { source->put(Values(1)); });
  EXPECT_TRUE(eventually([&] { return sink->size() == 1; })) << "what pass emitted to out waits behind nobody";
  EXPECT_TRUE(eventually([&] { return runtime.longest_call().component == "stuck"; }));
  source->put(Values(2));  // the spout and pass go on, on other threads
  other->put(Values(3));
  EXPECT_TRUE(eventually([&] { return sink->size() == 3 && other->acked().size() == 1; }));
  EXPECT_EQ(source->acked().size(), 0U);
  may_end.count_down();
  EXPECT_TRUE(eventually([&] { return source->acked().size() == 2; }));
  reader.join();
  EXPECT_TRUE(runtime.stop(120s));
  EXPECT_EQ(sink->size(), 5U);
}

TEST(HandOver, WhatWaitsInAListThatWasHandedOverGrowsLate) {
  Bench bench;
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("thrice", bolt(
                              [](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                                for (int i = 1; i <= 3; ++i) out.emit(tuple, Values(i));
                                out.ack(tuple);
                              },
                              {"value"}))
      .shuffle_grouping("in");
  builder
      .set_bolt("slow", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  sink->add(tuple, 0);
                  bench.clock.advance(30ms);
                  out.ack(tuple);
                }))
      .shuffle_grouping("thrice")
      .deadline(50ms);
  Runtime runtime(builder.build("late"), bench.options());
  runtime.start();
  source->put(Values(0));
  runtime.run_until_idle();
  EXPECT_THAT(sink->numbers(), ElementsAre(1, 2));
  EXPECT_EQ(runtime.snapshot().component("slow").late, 1U);
  EXPECT_EQ(source->acked().size(), 1U);
}

TEST(HandOver, AListLongerThanTheMailboxBlocksItsEmitterUntilHalfOfItIsDone) {
  Bench bench;
  auto options = bench.options();
  options.mailbox_capacity = 8;
  auto source = std::make_shared<Source>();
  std::vector<std::string> order;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("many", bolt(
                            [&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                              order.emplace_back("many");
                              for (int i = 0; i < 20; ++i) out.emit(tuple, Values(i));
                              out.ack(tuple);
                            },
                            {"value"}))
      .shuffle_grouping("in");
  builder
      .set_bolt("out", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  order.emplace_back("out");
                  out.ack(tuple);
                }))
      .shuffle_grouping("many");
  Runtime runtime(builder.build("long"), options);
  runtime.start();
  for (int i = 0; i < 2; ++i) source->lay(Values(i));
  source->wake();
  runtime.run_until_idle();
  ASSERT_EQ(order.size(), 42U);
  const auto second = std::find(order.begin() + 1, order.end(), "many") - order.begin();
  EXPECT_GE(second, 17);  // 20 less half of the mailbox
  EXPECT_EQ(source->acked().size(), 2U);
}

}  // namespace
}  // namespace iotcloud::topology::workshop
