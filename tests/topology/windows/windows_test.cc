#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/workshop.h>
#include <iotcloud/topology/windows/windowed_bolt.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

/// "1 2 3": the first fields.
std::string list(std::span<const Tuple> tuples) {
  std::string text;
  for (const Tuple& tuple : tuples) {
    text += (text.empty() ? "" : " ") + std::to_string(tuple.get<std::int64_t>(std::size_t{0}));
  }
  return text;
}

/// Emits what each window holds. Throws when a window holds the number 13.
struct Show : WindowedBolt {
  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare({"tuples", "added", "expired", "begin", "end"});
  }
  void prepare(const Config&, const TopologyContext&, WindowOutputCollector& collector) override { out_ = &collector; }
  void execute(const TupleWindow& window) override {
    for (const Tuple& tuple : window.tuples()) {
      if (tuple.get<std::int64_t>(std::size_t{0}) == 13) throw std::runtime_error("unlucky");
    }
    out_->emit(Values(list(window.tuples()), list(window.added()), list(window.expired()), window.begin_ms(),
                      window.end_ms()));
  }
  WindowOutputCollector* out_ = nullptr;
};

/// A source, the windows, and a sink that may leave what it gets unsettled.
class Windows {
 public:
  explicit Windows(const WindowOptions& options, const Config& config = {}, int sources = 1) {
    TopologyBuilder builder;
    builder.set_spout("in", source_spout(in, {"n", "time"}));
    auto declarer = builder.set_bolt("windows", make_windowed_bolt<Show>(options), 1, config).shuffle_grouping("in");
    if (sources == 2) {
      builder.set_spout("other", source_spout(other, {"n", "time"}));
      declarer.shuffle_grouping("other");
    }
    builder
        .set_bolt("sink", bolt([this](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
                    tuples.push_back(tuple.get<std::string>("tuples"));
                    added.push_back(tuple.get<std::string>("added"));
                    expired.push_back(tuple.get<std::string>("expired"));
                    borders.emplace_back(tuple.get<std::int64_t>("begin"), tuple.get<std::int64_t>("end"));
                    if (fail_all) {
                      collector.fail(tuple);
                    } else {
                      collector.ack(tuple);
                    }
                  }))
        .global_grouping("windows");
    if (!options.late_stream.empty()) {
      builder.set_bolt("late", sink_bolt(late)).global_grouping("windows", options.late_stream);
    }
    runtime.emplace(builder.build("t"), bench.options());
    runtime->start();
    runtime->run_until_idle();
  }
  void put(std::int64_t n, std::int64_t time_ms = 0) {
    in->put(Values(n, time_ms));
    runtime->run_until_idle();
  }
  void put_other(std::int64_t n, std::int64_t time_ms) {
    other->put(Values(n, time_ms));
    runtime->run_until_idle();
  }
  void pass(std::chrono::milliseconds time) {
    bench.clock.advance(time);
    runtime->run_due_timers();
    runtime->run_until_idle();
  }
  std::uint64_t counted(const std::string& name) {
    return bench.metrics.counter(name, "", {{"topology", "t"}, {"component", "windows"}, {"task", windows_task()}})
        .value();
  }
  std::string windows_task() const {
    for (const TaskSnapshot& task : runtime->snapshot().tasks) {
      if (task.component == "windows") return std::to_string(task.task_id);
    }
    return "";
  }

  Bench bench;
  std::shared_ptr<Source> in = std::make_shared<Source>();
  std::shared_ptr<Source> other = std::make_shared<Source>();
  std::shared_ptr<Sink> late = std::make_shared<Sink>();
  std::vector<std::string> tuples, added, expired;
  std::vector<std::pair<std::int64_t, std::int64_t>> borders;
  bool fail_all = false;
  std::optional<Runtime> runtime;
};

// By count.

TEST(Windows, TumblingCountsHoldEachTupleOnceAndLeaveTheRestOpen) {
  Windows windows({.length = 3});
  for (int n = 1; n <= 8; ++n) windows.put(n);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2 3", "4 5 6"));
  EXPECT_THAT(windows.added, ElementsAre("1 2 3", "4 5 6"));
  EXPECT_THAT(windows.expired, ElementsAre("", "1 2 3"));
  EXPECT_THAT(windows.in->acked(), UnorderedElementsAre(1, 2, 3, 4, 5, 6));
}

TEST(Windows, SlidingCountsOverlapAndSayWhatCameAndWhatWent) {
  Windows windows({.length = 4, .slide = 2});
  for (int n = 1; n <= 8; ++n) windows.put(n);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2", "1 2 3 4", "3 4 5 6", "5 6 7 8"));
  EXPECT_THAT(windows.added, ElementsAre("1 2", "3 4", "5 6", "7 8"));
  EXPECT_THAT(windows.expired, ElementsAre("", "", "1 2", "3 4"));
}

TEST(Windows, TuplesOfSlidingWindowsAreAckedWhenNoLaterWindowCanHoldThem) {
  Windows windows({.length = 4, .slide = 2});
  for (int n = 1; n <= 4; ++n) windows.put(n);
  EXPECT_THAT(windows.in->acked(), UnorderedElementsAre(1, 2));
  windows.put(5);
  EXPECT_THAT(windows.in->acked(), UnorderedElementsAre(1, 2));
  windows.put(6);
  EXPECT_THAT(windows.in->acked(), UnorderedElementsAre(1, 2, 3, 4));
}

TEST(Windows, TuplesBetweenHoppingCountsAreInNoWindowAndAcked) {
  Windows windows({.length = 1, .slide = 3});
  for (int n = 1; n <= 6; ++n) windows.put(n);
  EXPECT_THAT(windows.tuples, ElementsAre("3", "6"));
  EXPECT_THAT(windows.expired, ElementsAre("", "3"));
  EXPECT_THAT(windows.in->acked(), UnorderedElementsAre(1, 2, 3, 4, 5, 6));
}

// By processing time.

TEST(Windows, TumblingTimeIsEvaluatedByTheClockAlone) {
  Windows windows({.length = 100ms});
  windows.put(1);
  windows.pass(60ms);
  windows.put(2);
  EXPECT_THAT(windows.tuples, IsEmpty());
  windows.pass(40ms);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2"));
  windows.put(3);
  windows.pass(100ms);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2", "3"));
  EXPECT_THAT(windows.in->acked(), UnorderedElementsAre(1, 2, 3));
  EXPECT_EQ(windows.borders[0].second - windows.borders[0].first, 100);
  EXPECT_EQ(windows.borders[0].second, windows.borders[1].first);
}

TEST(Windows, SlidingTimeShowsATupleInEveryWindowItIsIn) {
  Windows windows({.length = 100ms, .slide = 50ms});
  windows.put(1);
  windows.pass(50ms);
  windows.put(2);
  windows.pass(50ms);
  EXPECT_THAT(windows.in->acked(), ElementsAre(1));
  windows.pass(50ms);
  windows.pass(50ms);
  EXPECT_THAT(windows.tuples, ElementsAre("1", "1 2", "2"));
  EXPECT_THAT(windows.added, ElementsAre("1", "2", ""));
  EXPECT_THAT(windows.expired, ElementsAre("", "", "1"));
}

TEST(Windows, ALateTickStillCutsTheWindowsWhereTheyEnd) {
  Windows windows({.length = 100ms});
  windows.put(1);
  windows.bench.clock.advance(110ms);
  windows.put(2);
  EXPECT_THAT(windows.tuples, ElementsAre("1"));
  windows.pass(500ms);
  EXPECT_THAT(windows.tuples, ElementsAre("1", "2"));
}

TEST(Windows, WithoutTuplesThereIsNoWindow) {
  Windows windows({.length = 10ms});
  for (int i = 0; i < 20; ++i) windows.pass(10ms);
  EXPECT_THAT(windows.tuples, IsEmpty());
  EXPECT_EQ(windows.counted("iotcloud_task_windows_total"), 0U);
}

// Mixed.

TEST(Windows, TheNewestTuplesByTheClock) {
  Windows windows({.length = 2, .slide = 100ms});
  for (int n = 1; n <= 3; ++n) windows.put(n);
  windows.pass(100ms);
  windows.pass(100ms);
  windows.put(4);
  windows.pass(100ms);
  EXPECT_THAT(windows.tuples, ElementsAre("2 3", "2 3", "3 4"));
  EXPECT_THAT(windows.added, ElementsAre("2 3", "", "4"));
}

TEST(Windows, ATimeEverySoManyTuples) {
  Windows windows({.length = 100ms, .slide = 2});
  windows.put(1);
  windows.pass(60ms);
  windows.put(2);
  windows.pass(60ms);
  windows.put(3);
  windows.put(4);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2", "2 3 4"));
  EXPECT_THAT(windows.in->acked(), ElementsAre(1));
}

// By event time.

WindowOptions event_time(WindowExtent length, WindowExtent slide = {}) {
  WindowOptions options;
  options.length = length;
  options.slide = slide;
  options.timestamp_field = "time";
  options.watermark_interval = 0ms;
  return options;
}

TEST(Windows, EventTimePutsTuplesThatAreOutOfOrderWhereTheyBelong) {
  WindowOptions options = event_time(100ms);
  options.lag = 50ms;
  Windows windows(options);
  windows.put(1, 1010);
  windows.put(3, 1120);
  windows.put(2, 1080);
  windows.put(4, 1149);
  EXPECT_THAT(windows.tuples, IsEmpty()) << "the watermark is 1099";
  windows.put(5, 1150);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2"));
  windows.put(6, 1260);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2", "3 4 5"));
  EXPECT_THAT(windows.borders, ElementsAre(std::pair(1000, 1100), std::pair(1100, 1200)));
}

TEST(Windows, ATupleBehindTheWatermarkGoesToTheLateStreamAnchored) {
  WindowOptions options = event_time(100ms);
  options.lag = 50ms;
  options.late_stream = "late";
  options.late_fields = {"n", "unknown"};
  Windows windows(options);
  windows.put(1, 1010);
  windows.put(2, 1200);
  windows.put(3, 1149);
  windows.put(4, 1150);
  EXPECT_THAT(windows.late->numbers(), ElementsAre(3));
  EXPECT_EQ(windows.late->items[0].values[1], Value());
  EXPECT_EQ(windows.counted("iotcloud_task_window_late_total"), 1U);
  EXPECT_THAT(windows.in->acked(), ElementsAre(1, 3));
  windows.put(5, 1350);
  EXPECT_THAT(windows.tuples, ElementsAre("1", "4", "2")) << "4 is at the watermark, so not late";
}

TEST(Windows, WithoutALateStreamLateTuplesAreCountedAndAcked) {
  Windows windows(event_time(100ms));
  windows.put(1, 1000);
  windows.put(2, 999);
  EXPECT_EQ(windows.counted("iotcloud_task_window_late_total"), 1U);
  EXPECT_THAT(windows.in->acked(), ElementsAre(2));
}

TEST(Windows, AWatermarkThatJumpsEvaluatesEveryWindowWithTuples) {
  WindowOptions options = event_time(100ms, 50ms);
  options.lag = 1000ms;
  Windows windows(options);
  windows.put(1, 1010);
  windows.put(2, 1060);
  windows.put(3, 1500);
  windows.put(4, 9'000'000'000'000);
  EXPECT_THAT(windows.tuples, ElementsAre("1", "1 2", "2", "3", "3"));
  EXPECT_THAT(windows.borders, ElementsAre(std::pair(950, 1050), std::pair(1000, 1100), std::pair(1050, 1150),
                                           std::pair(1450, 1550), std::pair(1500, 1600)));
  EXPECT_THAT(windows.in->acked(), UnorderedElementsAre(1, 2, 3));
}

TEST(Windows, TheWatermarkIsThatOfTheSlowestInput) {
  Windows windows(event_time(100ms), {}, 2);
  windows.put(1, 1010);
  windows.put(2, 1500);
  EXPECT_THAT(windows.tuples, IsEmpty()) << "nothing is known of the other input";
  windows.put_other(3, 1020);
  EXPECT_THAT(windows.tuples, IsEmpty());
  windows.put_other(4, 1099);
  EXPECT_THAT(windows.tuples, IsEmpty());
  windows.put_other(5, 1100);
  EXPECT_THAT(windows.tuples, ElementsAre("1 3 4"));
  EXPECT_EQ(windows.counted("iotcloud_task_window_late_total"), 0U);
}

TEST(Windows, EveryTaskOfAnInputHoldsTheWatermarkBack) {
  TopologyBuilder builder;
  auto source = std::make_shared<Source>();
  builder.set_spout("in", source_spout(source, {"n", "time"}));
  builder.set_bolt("pass", pass_bolt({"n", "time"}), 2).shuffle_grouping("in");
  builder.set_bolt("windows", make_windowed_bolt<Show>(event_time(100ms))).global_grouping("pass");
  CompleteOptions options;
  // In turn to the two tasks: one of them is far behind.
  options.inputs["in"] = {Values(1, 1000), Values(2, 1001), Values(3, 5000),
                          Values(4, 1050), Values(5, 6000), Values(6, 1100)};
  const auto result = complete_topology(builder.build("t"), options);
  const auto windows = result.tuples("windows");
  ASSERT_EQ(windows.size(), 1U);
  EXPECT_EQ(windows[0][0], Value("1 2 4"));
}

TEST(Windows, AnIdleSourceLetsTimeGoOnWhenSaid) {
  WindowOptions options = event_time(100ms);
  options.watermark_interval = 10ms;
  options.idle_source = 500ms;
  Windows windows(options, {}, 2);
  windows.put_other(1, 1010);
  windows.put(2, 1020);
  windows.pass(490ms);
  windows.put(3, 1200);
  windows.pass(9ms);
  EXPECT_THAT(windows.tuples, IsEmpty());
  windows.pass(11ms);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2"));
}

TEST(Windows, TheWatermarkMovesOnByItsIntervalWithoutATickOfTheUsers) {
  WindowOptions options = event_time(100ms);
  options.watermark_interval = 200ms;
  Windows windows(options);
  windows.put(1, 1010);
  windows.put(2, 1200);
  windows.put(3, 1020);
  EXPECT_THAT(windows.tuples, IsEmpty());
  windows.pass(199ms);
  EXPECT_THAT(windows.tuples, IsEmpty());
  windows.pass(1ms);
  EXPECT_THAT(windows.tuples, ElementsAre("1 3"));
}

TEST(Windows, EventTimeCountsInOrderOfTimeStamps) {
  WindowOptions options = event_time(3, 2);
  options.lag = 100ms;
  Windows windows(options);
  windows.put(2, 1020);
  windows.put(1, 1010);
  windows.put(4, 1040);
  windows.put(3, 1030);
  EXPECT_THAT(windows.tuples, IsEmpty());
  windows.put(5, 1140);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2", "2 3 4"));
  EXPECT_THAT(windows.borders.back(), testing::Pair(1020, 1040));
}

TEST(Windows, AFunctionMayFindTheTimeStamp) {
  WindowOptions options;
  options.length = 10ms;
  options.timestamp = [](const Tuple& tuple) { return 2 * tuple.get<std::int64_t>("n"); };
  options.watermark_interval = 0ms;
  Windows windows(options);
  for (int n = 1; n <= 5; ++n) windows.put(n);
  EXPECT_THAT(windows.tuples, ElementsAre("1 2 3 4"));
}

TEST(Windows, ATupleWithoutTimeStampFailsAlone) {
  WindowOptions options = event_time(100ms);
  options.timestamp_field = "nothing";
  Windows windows(options);
  windows.put(1, 1010);
  EXPECT_THAT(windows.in->failed(), ElementsAre(1));
  EXPECT_THAT(windows.runtime->snapshot().component("windows").last_error, HasSubstr("nothing"));
}

// Reliability.

TEST(Windows, WhatAWindowEmitsIsAnchoredToAllItsTuples) {
  Windows windows({.length = 3});
  windows.fail_all = true;
  for (int n = 1; n <= 3; ++n) windows.put(n);
  EXPECT_THAT(windows.in->failed(), UnorderedElementsAre(1, 2, 3));
  EXPECT_THAT(windows.in->acked(), IsEmpty());
}

TEST(Windows, AWindowThatThrowsFailsItsTuplesAndTheNextGoesOn) {
  Windows windows({.length = 4, .slide = 2});
  windows.put(1);
  windows.put(13);
  EXPECT_THAT(windows.in->failed(), UnorderedElementsAre(1, 2));
  EXPECT_THAT(windows.runtime->snapshot().component("windows").last_error, HasSubstr("unlucky"));
  for (int n = 3; n <= 6; ++n) windows.put(n);
  EXPECT_THAT(windows.tuples, ElementsAre("3 4", "3 4 5 6"));
  EXPECT_THAT(windows.in->failed(), UnorderedElementsAre(1, 2));
}

// Configuration.

TEST(Windows, TheConfigurationOverridesTheOptions) {
  Windows windows({.length = 100}, {{"window.length", "2"}, {"window.slide", "1"}});
  for (int n = 1; n <= 3; ++n) windows.put(n);
  EXPECT_THAT(windows.tuples, ElementsAre("1", "1 2", "2 3"));
}

TEST(Windows, ATimeFromTheConfigurationTicksToo) {
  Windows windows({.length = 100}, {{"window.length", "50ms"}});
  windows.put(1);
  windows.pass(50ms);
  EXPECT_THAT(windows.tuples, ElementsAre("1"));
}

TEST(Windows, OptionsThatMakeNoWindowsAreRefusedWhenTheTopologyIsBuilt) {
  const auto problem = [](const WindowOptions& options, const Config& config = {}) -> std::string {
    try {
      const Windows windows(options, config);
    } catch (const TopologyError& e) {
      return e.component() + ": " + e.what();
    }
    return "";
  };
  EXPECT_THAT(problem({}), HasSubstr("windows: "));
  EXPECT_THAT(problem({}), HasSubstr("window.length"));
  EXPECT_THAT(problem({.length = 3}, {{"window.slide", "ten"}}), HasSubstr("\"ten\" cannot be read"));
  EXPECT_THAT(problem({.length = -3}), HasSubstr("more than zero"));
  EXPECT_THAT(problem({.length = 3, .lag = 5ms}), HasSubstr("event time"));
}

}  // namespace
}  // namespace iotcloud::topology::workshop
