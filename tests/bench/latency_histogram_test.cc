#include <cmath>

#include <gtest/gtest.h>

#include <iotcloud/bench/harness/latency_histogram.h>

namespace iotcloud::bench {
namespace {

TEST(LatencyHistogram, HasQuantilesWithinOnePercent) {
  LatencyHistogram histogram;
  for (std::int64_t us = 1; us <= 100'000; ++us) histogram.record_ns(us * 1000);
  const auto summary = histogram.summary();
  EXPECT_EQ(summary.count, 100'000);
  EXPECT_NEAR(summary.p50_us, 50'000, 50'000 * 0.004);
  EXPECT_NEAR(summary.p99_us, 99'000, 99'000 * 0.004);
}

TEST(LatencyHistogram, HasEveryDurationWithinOnePercent) {
  for (std::int64_t ns = 128; ns < std::int64_t{1} << 40; ns = ns * 9 / 8 + 1) {
    LatencyHistogram histogram;
    histogram.record_ns(ns);
    histogram.record_ns(ns + 1);  // so that the maximum does not hide the bucket's middle
    ASSERT_NEAR(histogram.counts().front().first * 1000, static_cast<double>(ns), 0.004 * static_cast<double>(ns) + 1);
  }
}

TEST(LatencyHistogram, HasTheExactMeanDeviationAndMaximum) {
  LatencyHistogram histogram;
  for (const std::int64_t us : {200, 400, 400, 400, 500, 500, 700, 900}) histogram.record_ns(us * 1000);
  const auto summary = histogram.summary();
  EXPECT_DOUBLE_EQ(summary.mean_us, 500);
  EXPECT_DOUBLE_EQ(summary.stddev_us, 200);
  EXPECT_DOUBLE_EQ(summary.max_us, 900);
}

TEST(LatencyHistogram, TakesEveryDurationThereIs) {
  LatencyHistogram histogram;
  for (const std::int64_t ns : {std::int64_t{-5}, std::int64_t{0}, std::int64_t{1}, std::int64_t{127}, INT64_MAX}) {
    histogram.record_ns(ns);
  }
  const auto summary = histogram.summary();
  EXPECT_EQ(summary.count, 5);
  EXPECT_DOUBLE_EQ(summary.p50_us, 0.001);
  EXPECT_GT(summary.max_us, 9e15);
}

TEST(LatencyHistogram, IsZeroWithoutAny) {
  const auto summary = LatencyHistogram().summary();
  EXPECT_EQ(summary.count, 0);
  EXPECT_EQ(summary.mean_us, 0);
  EXPECT_EQ(summary.stddev_us, 0);
  EXPECT_EQ(summary.p99_us, 0);
}

}  // namespace
}  // namespace iotcloud::bench
