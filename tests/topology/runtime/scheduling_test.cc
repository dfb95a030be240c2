#include <latch>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

RuntimeOptions with_threads(unsigned threads, config::Metrics& metrics) {
  RuntimeOptions options;
  options.threads = threads;
  options.metrics = &metrics;
  return options;
}

TEST(Scheduling, ATasksCallsNeverOverlapUnderManyWakers) {
  auto source = std::make_shared<Source>();
  int unguarded = 0;  // the thread sanitizer sees any overlap
  std::atomic<int> inside{0}, overlaps{0};
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("count", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  if (++inside != 1) ++overlaps;
                  ++unguarded;
                  --inside;
                  out.ack(tuple);
                }))
      .shuffle_grouping("in");
  config::Metrics metrics;
  Runtime runtime(builder.build("serial"), with_threads(2, metrics));
  runtime.start();
  constexpr std::size_t wakers = 4, each = 2000;
  {
    std::vector<std::jthread> threads;
    threads.reserve(wakers);
    for (std::size_t t = 0; t < wakers; ++t) {
      threads.emplace_back([&] {
        for (std::size_t i = 0; i < each; ++i) source->put(Values(i));
      });
    }
  }
  EXPECT_TRUE(eventually([&] { return source->acked().size() == wakers * each; }));
  EXPECT_TRUE(runtime.stop(120s));
  EXPECT_EQ(unguarded, static_cast<int>(wakers * each));
  EXPECT_EQ(overlaps, 0);
}

/// A wake that finds the spout at its limit does not run it: what ends that must see that there is something new.
TEST(Scheduling, NoWakeIsLostBesideTheLimitOfPending) {
  auto source = std::make_shared<Source>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("pass", pass_bolt()).shuffle_grouping("in");
  builder.set_bolt("out", sink_bolt(std::make_shared<Sink>())).shuffle_grouping("pass");
  config::Metrics metrics;
  auto options = with_threads(2, metrics);
  options.max_spout_pending = 1;
  options.caller_slice = 0us;  // the pool runs what the wake begins
  Runtime runtime(builder.build("limited"), options);
  runtime.start();
  std::size_t sent = 0;
  for (int round = 0; round < 300; ++round) {
    for (int i = 0; i < 3; ++i, ++sent) source->put(Values(i));
    ASSERT_TRUE(eventually([&] { return source->acked().size() == sent; })) << "round " << round;
  }
  EXPECT_TRUE(runtime.stop(120s));
}

TEST(Scheduling, HandsTheRestToThePoolWhileABoltIsLong) {
  auto source = std::make_shared<Source>();
  std::latch may_end(1);
  std::atomic<bool> quick_ran{false};
  std::thread::id long_thread, quick_thread;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("long", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  long_thread = std::this_thread::get_id();
                  may_end.wait();
                  out.ack(tuple);
                }))
      .shuffle_grouping("in");
  builder
      .set_bolt("quick", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  quick_thread = std::this_thread::get_id();
                  out.ack(tuple);
                  quick_ran = true;
                }))
      .shuffle_grouping("in");
  config::Metrics metrics;
  // Two: on a slow machine the pool gets the long one, too.
  Runtime runtime(builder.build("long"), with_threads(2, metrics));
  runtime.start();
  ASSERT_TRUE(eventually([&] { return runtime.idle(); }));
  std::jthread reader([&] { source->put(Values(1)); });
  EXPECT_TRUE(eventually([&] { return quick_ran.load(); }));  // while the reader is still in "long", or after it
  may_end.count_down();
  reader.join();
  EXPECT_TRUE(runtime.stop(120s));
  EXPECT_NE(quick_thread, long_thread);
}

TEST(Scheduling, WakeReturnsAfterItsSliceAndThePoolDoesTheRest) {
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("pass", pass_bolt()).shuffle_grouping("in");
  builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("pass");
  config::Metrics metrics;
  auto options = with_threads(2, metrics);
  options.caller_slice = 0us;
  Runtime runtime(builder.build("slice"), options);
  runtime.start();
  ASSERT_TRUE(eventually([&] { return runtime.idle(); }));
  for (int i = 0; i < 1000; ++i) source->lay(Values(i));
  source->wake();
  EXPECT_TRUE(eventually([&] { return sink->size() == 1000; }));
  EXPECT_TRUE(runtime.stop(120s));
  std::int64_t expected = 0;
  for (const std::int64_t number : sink->numbers()) EXPECT_EQ(number, expected++);  // order is kept across threads
  EXPECT_NE(sink->items.back().thread, std::this_thread::get_id());
}

TEST(Scheduling, AWakeFromInsideABoltRunsAfterItOnTheSameThread) {
  auto source = std::make_shared<Source>();
  auto echo = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  bool inside = false;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_spout("echo", source_spout(echo));
  builder
      .set_bolt("calls", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  inside = true;
                  echo->put(Values(2));
                  EXPECT_EQ(sink->size(), 0U);  // no recursion
                  inside = false;
                  out.ack(tuple);
                }))
      .shuffle_grouping("in");
  builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("echo");
  config::Metrics metrics;
  auto options = with_threads(1, metrics);
  options.caller_slice = options.long_slice = 1h;  // however slow the machine is
  Runtime runtime(builder.build("nested"), options);
  runtime.start();
  ASSERT_TRUE(eventually([&] { return runtime.idle(); }));
  source->put(Values(1));
  ASSERT_EQ(sink->size(), 1U);
  EXPECT_EQ(sink->items[0].thread, std::this_thread::get_id());
}

TEST(Scheduling, RunsTimersByTheMachinesClockToo) {
  std::atomic<int> ticks{0};
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(std::make_shared<Source>()));
  builder.set_bolt("ticking", bolt([&](const Tuple&, OutputCollector&, const TopologyContext&) { ++ticks; }))
      .shuffle_grouping("in")
      .tick(1ms);
  config::Metrics metrics;
  Runtime runtime(builder.build("ticks"), with_threads(1, metrics));
  runtime.start();
  EXPECT_TRUE(eventually([&] { return ticks >= 3; }));
}

TEST(Scheduling, ThousandsOfTasksWork) {
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_bolt("out", sink_bolt(sink), 1000).shuffle_grouping("in");
  config::Metrics metrics;
  Runtime runtime(builder.build("many"), with_threads(2, metrics));
  runtime.start();
  for (int i = 0; i < 2000; ++i) source->put(Values(i));
  EXPECT_TRUE(eventually([&] { return source->acked().size() == 2000; }));
  EXPECT_TRUE(runtime.stop(120s));
  EXPECT_EQ(sink->size(), 2000U);
}

}  // namespace
}  // namespace iotcloud::topology::workshop
