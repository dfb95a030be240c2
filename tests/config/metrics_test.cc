#include <algorithm>
#include <atomic>
#include <cmath>
#include <latch>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/config/metrics.h>

namespace iotcloud::config {
namespace {

TEST(Histogram, has_quantiles_within_its_resolution) {
  Histogram histogram;
  for (int i = 1; i <= 10000; ++i) histogram.record_ns(std::int64_t{i} * 1000);
  const auto summary = histogram.summary();
  EXPECT_EQ(summary.count, 10000U);
  EXPECT_NEAR(summary.p50_ns, 5e6, 5e6 * 0.045);
  EXPECT_NEAR(summary.p99_ns, 9.9e6, 9.9e6 * 0.045);
  EXPECT_DOUBLE_EQ(summary.max_ns, 1e7);
  EXPECT_NEAR(summary.mean_ns, 5.0005e6, 1);
}

TEST(Histogram, holds_the_smallest_and_the_largest_durations) {
  Histogram histogram;
  histogram.record_ns(-5);
  histogram.record_ns(0);
  histogram.record_ns(15);
  histogram.record_ns(16);
  histogram.record_ns(INT64_MAX);
  const auto summary = histogram.summary();
  EXPECT_EQ(summary.count, 5U);
  EXPECT_DOUBLE_EQ(summary.p50_ns, 15);
  EXPECT_DOUBLE_EQ(summary.max_ns, static_cast<double>(INT64_MAX));
}

TEST(Histogram, is_empty_before_the_first_sample) {
  EXPECT_EQ(Histogram().summary().count, 0U);
}

TEST(Metrics, gives_the_same_object_for_the_same_name_and_labels) {
  Metrics metrics;
  auto& a = metrics.counter("frames_total", "Frames", {{"driver", "a"}});
  auto& b = metrics.counter("frames_total", "Frames", {{"driver", "b"}});
  EXPECT_NE(&a, &b);
  EXPECT_EQ(&a, &metrics.counter("frames_total", "Frames", {{"driver", "a"}}));
}

TEST(Metrics, counts_from_several_threads_without_losing_any) {
  Metrics metrics;
  {
    std::vector<std::jthread> threads;
    threads.reserve(4);
    for (int t = 0; t < 4; ++t) {
      threads.emplace_back([&metrics] {
        for (int i = 0; i < 1000; ++i) {
          metrics.counter("n_total", "N").add();
          metrics.histogram("t_seconds", "T").record_ns(i);
          if (i % 100 == 0) static_cast<void>(metrics.collect());
        }
      });
    }
  }
  EXPECT_EQ(metrics.counter("n_total", "N").value(), 4000U);
  EXPECT_EQ(metrics.histogram("t_seconds", "T").summary().count, 4000U);
}

TEST(Metrics, collects_what_was_reported) {
  Metrics metrics;
  metrics.gauge("depth", "Depth", {{"task", "1"}}).set(-3);
  const auto samples = metrics.collect();
  ASSERT_EQ(samples.size(), 1U);
  EXPECT_EQ(samples[0].name, "depth");
  EXPECT_EQ(samples[0].labels.at("task"), "1");
  EXPECT_EQ(samples[0].value, -3);
}

TEST(Metrics, is_not_kept_waiting_by_a_source_that_is_slow) {
  Metrics metrics;
  std::latch began(1), may_end(1);
  const auto slow = metrics.add_source([&](std::vector<Sample>&) {
    began.count_down();
    may_end.wait();
  });
  auto other = metrics.add_source([](std::vector<Sample>&) {});
  std::jthread collector([&] { EXPECT_TRUE(metrics.collect().empty()); });
  began.wait();
  other = {};
  const auto fresh = metrics.add_source([](std::vector<Sample>&) {});
  may_end.count_down();
}

TEST(Metrics, waits_for_a_source_that_runs_when_it_is_to_end) {
  Metrics metrics;
  std::latch began(1);
  std::atomic<bool> running{false};
  auto source = metrics.add_source([&](std::vector<Sample>&) {
    running = true;
    began.count_down();
    std::this_thread::yield();
    running = false;
  });
  std::jthread collector([&] { EXPECT_TRUE(metrics.collect().empty()); });
  began.wait();
  source = {};
  EXPECT_FALSE(running);
}

TEST(Metrics, lets_a_source_end_itself) {
  Metrics metrics;
  int calls = 0;
  Metrics::SourceRegistration own;
  own = metrics.add_source([&](std::vector<Sample>& samples) {
    ++calls;
    samples.emplace_back();
    own = {};
  });
  EXPECT_EQ(metrics.collect().size(), 1U);
  EXPECT_TRUE(metrics.collect().empty());
  EXPECT_EQ(calls, 1);
}

TEST(Histogram, SpreadsItsSamplesOverQuartersOfAnOctave) {
  Histogram histogram;
  EXPECT_TRUE(histogram.spread().empty());
  histogram.record_ns(1000, 3);
  histogram.record_ns(1'000'000);
  histogram.record_ns(1);
  const auto spread = histogram.spread();
  ASSERT_EQ(spread.size(), 3u);
  EXPECT_EQ(spread[1].second, 3u);
  EXPECT_GE(spread[1].first, 1000);
  EXPECT_LE(spread[1].first, 1000 * 1.25);
  EXPECT_EQ(spread[2].second, 1u);
  EXPECT_GE(spread[2].first, 1'000'000);
}

}  // namespace
}  // namespace iotcloud::config
