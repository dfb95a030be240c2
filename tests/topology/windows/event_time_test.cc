// Windows by the time that stands in the tuples.
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

}  // namespace
}  // namespace iotcloud::topology::workshop
