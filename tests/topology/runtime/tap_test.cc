#include <algorithm>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr double every_one = std::numeric_limits<double>::infinity();

/// in -> pass -> out.
struct Tapped {
  Tapped() {
    TopologyBuilder builder;
    builder.set_spout("in", source_spout(source));
    builder.set_bolt("pass", pass_bolt()).shuffle_grouping("in");
    builder.set_bolt("out", sink_bolt(sink)).shuffle_grouping("pass");
    runtime = std::make_unique<Runtime>(builder.build("tapped"), bench.options());
    runtime->start();
  }
  void put(int from, int to) {
    for (int i = from; i <= to; ++i) source->lay(Values(i));
    source->wake();
    runtime->run_until_idle();
  }
  Bench bench;
  std::shared_ptr<Source> source = std::make_shared<Source>();
  std::shared_ptr<Sink> sink = std::make_shared<Sink>();
  std::unique_ptr<Runtime> runtime;
};

TEST(Tap, ShowsWhatSpoutsAndBoltsEmitAndWhatASinkGets) {
  Tapped tapped;
  std::vector<std::string> seen;
  std::vector<std::unique_ptr<Tap>> taps;
  for (const char* component : {"in", "pass", "out"}) {
    taps.push_back(tapped.runtime->tap(component, every_one, [&, component](const Tuple& tuple, int task) {
      seen.push_back(std::string(component) + "/" + std::to_string(task) + ":" + tuple.source_component() +
                     std::to_string(tuple.get<std::int64_t>("value")));
    }));
  }
  tapped.put(1, 1);
  EXPECT_THAT(seen, ElementsAre("in/1:in1", "pass/2:pass1", "out/3:pass1"));
  EXPECT_EQ(tapped.source->acked().size(), 1U) << "who watches holds nothing up";
}

TEST(Tap, EndsWithItsObject) {
  Tapped tapped;
  int seen = 0;
  auto tap = tapped.runtime->tap("pass", every_one, [&](const Tuple&, int) { ++seen; });
  tapped.put(1, 3);
  EXPECT_EQ(seen, 3);
  tap.reset();
  tapped.put(4, 6);
  EXPECT_EQ(seen, 3);
  EXPECT_THAT(tapped.sink->numbers(), ElementsAre(1, 2, 3, 4, 5, 6));
}

TEST(Tap, MayBeEndedByItsOwnCall) {
  Tapped tapped;
  int seen = 0;
  std::unique_ptr<Tap> tap;
  tap = tapped.runtime->tap("pass", every_one, [&](const Tuple&, int) {
    if (++seen == 2) tap.reset();
  });
  tapped.put(1, 5);
  EXPECT_EQ(seen, 2);
  EXPECT_THAT(tapped.sink->numbers(), ElementsAre(1, 2, 3, 4, 5));
}

TEST(Tap, ShowsNoMoreThanWasAskedFor) {
  Tapped tapped;
  int seen = 0;
  const auto tap = tapped.runtime->tap("in", 1e-3, [&](const Tuple&, int) { ++seen; });  // one in 1000 s
  tapped.put(1, 500);
  EXPECT_EQ(seen, 1);
}

TEST(Tap, MayOutliveTheRuntime) {
  Tapped tapped;
  const auto tap = tapped.runtime->tap("in", every_one, [](const Tuple&, int) {});
  tapped.put(1, 1);
  tapped.runtime.reset();
}

TEST(Tap, AWatcherThatThrowsIsDroppedAndTheTopologyGoesOn) {
  Tapped tapped;
  int calls = 0;
  const auto tap = tapped.runtime->tap("in", every_one, [&](const Tuple&, int) {
    ++calls;
    throw std::runtime_error("no more paper");
  });
  tapped.put(1, 5);
  EXPECT_EQ(calls, 1);
  EXPECT_EQ(tapped.sink->size(), 5U);
  EXPECT_EQ(tapped.runtime->snapshot().component("in").errors, 0U);
}

TEST(Tap, AComponentThatIsNotThereIsRefused) {
  Tapped tapped;
  try {
    static_cast<void>(tapped.runtime->tap("psas", every_one, [](const Tuple&, int) {}));
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), HasSubstr("it has: in, pass, out"));
  }
}

TEST(TaskMetrics, AreReadFromTheTasksWhenSomebodyAsks) {
  Tapped tapped;
  tapped.put(1, 3);
  const auto value_of = [&](const std::string& name, const std::string& component) {
    for (const auto& sample : tapped.bench.metrics.collect()) {
      if (sample.name == name && sample.labels.at("component") == component) {
        return sample.kind == config::Sample::Kind::histogram ? static_cast<double>(sample.histogram.count)
                                                              : sample.value;
      }
    }
    return -1.0;
  };
  EXPECT_EQ(value_of("iotcloud_task_emitted_total", "in"), 3);
  EXPECT_EQ(value_of("iotcloud_task_executed_total", "out"), 3);
  EXPECT_EQ(value_of("iotcloud_task_acked_total", "in"), 3);
  EXPECT_EQ(value_of("iotcloud_task_execute_seconds", "out"), 3);
  EXPECT_EQ(value_of("iotcloud_task_process_seconds", "out"), 3);
  EXPECT_EQ(value_of("iotcloud_spout_complete_seconds", "in"), 3);
  EXPECT_EQ(value_of("iotcloud_task_queue_depth", "out"), 0);
  tapped.runtime.reset();
  EXPECT_THAT(tapped.bench.metrics.collect(), IsEmpty());
}

TEST(TaskMetrics, TheProcessLatencyOfATupleThatIsKeptEndsWithItsAck) {
  Bench bench;
  auto source = std::make_shared<Source>();
  std::vector<Tuple> kept;
  TopologyBuilder builder;
  builder.set_spout("in", source_spout(source));
  builder
      .set_bolt("keep", bolt([&](const Tuple& tuple, OutputCollector& out, const TopologyContext&) {
                  if (tuple.get<std::int64_t>(0) == 1) {
                    kept.push_back(tuple);
                    return;
                  }
                  for (const Tuple& earlier : kept) out.ack(earlier);
                  kept.clear();
                  out.ack(tuple);
                }))
      .shuffle_grouping("in");
  Runtime runtime(builder.build("kept"), bench.options());
  runtime.start();
  source->put(Values(1));
  runtime.run_until_idle();
  EXPECT_EQ(runtime.snapshot().component("keep").process_latency.count, 0U);
  source->put(Values(2));
  runtime.run_until_idle();
  EXPECT_EQ(runtime.snapshot().component("keep").process_latency.count, 2U);
  EXPECT_EQ(runtime.snapshot().component("keep").execute_latency.count, 2U);
}

}  // namespace
}  // namespace iotcloud::topology::workshop
