#include <algorithm>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

bool was_throttled(const Source& source) {
  const auto calls = source.calls();
  return std::find(calls.begin(), calls.end(), "throttled") != calls.end();
}

/// in -> triple -> slow; with its first tuple the slow bolt waits until the spout is told that the queue behind it is
/// full, and looks at the depths of both queues each time.
TEST(BackPressure, NoQueueGrowsBeyondItsBoundAndNothingIsLost) {
  constexpr std::size_t capacity = 16, count = 200;
  Bench bench;
  auto options = bench.options();
  options.threads = 2;  // one of them waits in the slow bolt, the other runs the spout
  options.mailbox_capacity = capacity;
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  Runtime* running = nullptr;
  std::size_t deepest = 0;
  bool was_full = false;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("triple", bolt(
                              [](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                                for (int i = 0; i < 3; ++i) out.emit(tuple, Values(tuple.at(0)));
                                out.ack(tuple);
                              },
                              {"value"}))
      .shuffle_grouping("in");
  builder
      .set_bolt("slow", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  if (!was_full) was_full = eventually([&] { return was_throttled(*source); });
                  for (const auto& task : running->snapshot().tasks) deepest = std::max(deepest, task.queue_depth);
                  sink->add(tuple, 0);
                  out.ack(tuple);
                }))
      .shuffle_grouping("triple");
  Runtime runtime(builder.build("bounded"), options);
  running = &runtime;
  runtime.start();
  // All are there before anything runs: this thread may be the one that waits in the slow bolt.
  for (std::size_t i = 0; i < count; ++i) source->lay(Values(i));
  source->wake();
  EXPECT_TRUE(eventually([&] { return source->acked().size() == count; }));
  EXPECT_TRUE(runtime.stop(120s));
  EXPECT_EQ(sink->size(), 3 * count);
  EXPECT_EQ(source->acked().size(), count);
  EXPECT_TRUE(was_full);
  EXPECT_LE(deepest, capacity + 2);  // one call emits three
}

TEST(BackPressure, ASpoutIsNotAskedWhileWhatItFeedsIsFullAndIsTold) {
  Bench bench;
  auto options = bench.options();
  options.threads = 2;  // one of them may be stuck in the slow bolt for as long as it takes
  options.mailbox_capacity = 8;
  auto source = std::make_shared<Source>();
  auto other = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  std::atomic<bool> go{false};
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder.set_spout("other", source_spout(other));
  builder
      .set_bolt("slow", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  while (!go) std::this_thread::yield();
                  out.ack(tuple);
                }))
      .shuffle_grouping("in");
  builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("other");
  Runtime runtime(builder.build("told"), options);
  runtime.start();
  ASSERT_TRUE(eventually([&] { return runtime.idle(); }));
  std::jthread reader([&] {
    for (int i = 0; i < 100; ++i) source->put(Values(i));
  });
  ASSERT_TRUE(eventually([&] { return runtime.snapshot().component("slow").queue_depth > 0; }));
  // Whoever runs the slow bolt is stuck in it; another thread runs the spout, until its target is full.
  ASSERT_TRUE(eventually([&] {
    source->put(Values(0));
    return was_throttled(*source);
  }));
  EXPECT_LE(runtime.snapshot().component("slow").queue_depth, 8U);
  // What does not feed the slow bolt goes on.
  other->put(Values(1));
  EXPECT_TRUE(eventually([&] { return sink->size() == 1; }));
  go = true;
  reader.join();
  EXPECT_TRUE(eventually([&] { return source->waiting() == 0; }));
  EXPECT_TRUE(runtime.stop(120s));
  const auto calls = source->calls();
  EXPECT_NE(std::find(calls.begin(), calls.end(), "unthrottled"), calls.end());
  EXPECT_EQ(source->acked().size(), runtime.snapshot().component("slow").acked);
}

TEST(BackPressure, AcksPassAFullQueue) {
  // "keep" waits for room in "stuck" while tuples wait in its own queue; the ack of one that it had before passes them.
  std::atomic<bool> go{false};
  std::mutex mutex;
  Tuple first;
  bool kept = false;
  OutputCollector* collector = nullptr;
  config::Metrics metrics;
  RuntimeOptions options;
  options.threads = 2;
  options.metrics = &metrics;
  options.mailbox_capacity = 4;
  auto source = std::make_shared<Source>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("keep", bolt(
                            [&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                              const std::lock_guard lock(mutex);
                              collector = &out;
                              out.emit(Values(tuple.at("value")));
                              std::exchange(kept, true) ? out.ack(tuple) : void(first = tuple);
                            },
                            {"value"}))
      .shuffle_grouping("in");
  builder
      .set_bolt("stuck", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  while (!go) std::this_thread::yield();
                  out.ack(tuple);
                }))
      .shuffle_grouping("keep");
  Runtime runtime(builder.build("acks"), options);
  runtime.start();
  for (int i = 0; i < 50; ++i) source->lay(Values(i));
  std::jthread waker([&] { source->wake(); });
  ASSERT_TRUE(eventually([&] {
    const Snapshot now = runtime.snapshot();
    return now.component("stuck").queue_depth >= 4 && now.component("keep").queue_depth >= 4;
  }));
  {
    const std::lock_guard lock(mutex);
    collector->ack(first);
    first = Tuple();
  }
  EXPECT_TRUE(eventually([&] {
    const auto acked = source->acked();
    return std::find(acked.begin(), acked.end(), 1U) != acked.end();
  }));
  EXPECT_GE(runtime.snapshot().component("keep").queue_depth, 4U);  // still full
  go = true;
  waker.join();
  EXPECT_TRUE(eventually([&] { return source->acked().size() == 50; }));
  EXPECT_TRUE(runtime.stop(120s));
}

TEST(BackPressure, ManyEmittersIntoOneSlowTaskAllFinish) {
  constexpr int emitters = 8, each = 500;
  config::Metrics metrics;
  RuntimeOptions options;
  options.threads = 2;
  options.metrics = &metrics;
  options.mailbox_capacity = 8;
  auto source = std::make_shared<Source>();
  auto sink = std::make_shared<Sink>();
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source), 2);
  builder.set_bolt("wide", pass_bolt(), emitters).shuffle_grouping("in");
  builder.set_bolt("one", sink_bolt(sink)).global_grouping("wide");
  Runtime runtime(builder.build("fan-in"), options);
  runtime.start();
  for (int i = 0; i < emitters * each; ++i) source->lay(Values(i));
  std::atomic<bool> done{false};
  std::jthread waker([&] {
    while (!done) source->wake();
  });
  EXPECT_TRUE(eventually([&] { return sink->size() == std::size_t{emitters} * each; }));
  done = true;
  waker.join();
  EXPECT_TRUE(runtime.stop(120s));
}

}  // namespace
}  // namespace iotcloud::topology::workshop
