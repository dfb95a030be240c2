// Windows by count and by the clock.
#include <chrono>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/topology/windows/windows_fixture.h>

namespace iotcloud::topology::workshop {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

TEST(Windows, ALengthOrSlideMayBeATimeInAnyUnit) {
  using namespace std::chrono_literals;
  const WindowOptions options{.length = 10s, .slide = 1min};
  EXPECT_EQ(options.length.duration, 10'000ms);
  EXPECT_EQ(options.slide.duration, 60'000ms);
  EXPECT_FALSE(options.length.counts());
}

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

TEST(Windows, SayForHowLongTheyKeepATuple) {
  using namespace std::chrono_literals;
  const auto hold = [](const WindowOptions& options, const Config& config = {}) {
    return make_windowed_bolt<Show>(options)()->holds_tuples_for(config);
  };
  EXPECT_EQ(hold({.length = 10s}), 10s);
  EXPECT_EQ(hold({.length = 10s, .slide = 2s}), 10s);
  EXPECT_EQ(hold({.length = 2s, .slide = 10s}), 10s) << "a tuple between two windows";
  EXPECT_EQ(hold({.length = 10s}, {{"window.length", "1m"}}), 60s);
  EXPECT_EQ(hold({.length = 100}), Bolt::until_others_come);
  EXPECT_EQ(hold({.length = 100, .slide = 2s}), Bolt::until_others_come);
  EXPECT_EQ(hold({.length = 10s, .slide = 5}), Bolt::until_others_come);
  EXPECT_EQ(hold({.length = 10s, .timestamp_field = "time", .lag = 500ms, .watermark_interval = 1s}), 11500ms);
}

TEST(Windows, TheConfigurationOverridesTheOptions) {
  Windows windows({.length = 100}, {{"window.length", "2"}, {"window.slide", "1"}});
  for (int n = 1; n <= 3; ++n) windows.put(n);
  EXPECT_THAT(windows.tuples, ElementsAre("1", "1 2", "2 3"));
}

TEST(Windows, AMisspeltKeyOfTheConfigurationIsRefused) {
  const auto refusal = [](const Config& config) -> std::string {
    try {
      static_cast<void>(configured({.length = 1}, config));
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "";
  };
  EXPECT_EQ(refusal({{"window.lenght", "2"}}), "conf: window.lenght: unknown key; did you mean \"window.length\"?");
  EXPECT_THAT(refusal({{"window.colour", "2"}}), HasSubstr("known are window.length, window.slide"));
  EXPECT_THAT(refusal({{"window.lag", "2"}}), HasSubstr("write a number and a unit"));
  EXPECT_EQ(refusal({{"colour", "blue"}}), "");
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
