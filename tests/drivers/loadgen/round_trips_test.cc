#include <gmock/gmock.h>

#include <iotcloud/drivers/loadgen/round_trips.h>

namespace iotcloud::drivers::loadgen {
namespace {

using namespace std::chrono_literals;

TEST(Latencies, have_quantiles_within_their_buckets) {
  Latencies latencies;
  for (int us = 1; us <= 10'000; ++us) latencies.add(std::chrono::microseconds(us));
  EXPECT_EQ(latencies.count(), 10'000);
  EXPECT_NEAR(latencies.quantile_us(0.5), 5000, 5000 * 0.016);
  EXPECT_NEAR(latencies.quantile_us(0.99), 9900, 9900 * 0.016);
  EXPECT_DOUBLE_EQ(latencies.quantile_us(1), 10'000);
  EXPECT_NEAR(latencies.mean_us(), 5000.5, 0.01);
}

TEST(Latencies, take_every_duration_there_is) {
  Latencies latencies;
  for (const auto duration :
       {std::chrono::nanoseconds(-5), 0ns, 1ns, 31ns, 32ns, 33ns, std::chrono::nanoseconds::max()}) {
    latencies.add(duration);
  }
  EXPECT_EQ(latencies.count(), 7);
  EXPECT_DOUBLE_EQ(latencies.quantile_us(0), 0);
  EXPECT_DOUBLE_EQ(latencies.quantile_us(0.5), 0.031);
  EXPECT_GT(latencies.quantile_us(0.99), 9e15);
}

TEST(Latencies, are_zero_when_there_are_none) {
  EXPECT_EQ(Latencies().quantile_us(0.99), 0);
  EXPECT_EQ(Latencies().mean_us(), 0);
}

TEST(RoundTrips, count_each_message_once) {
  RoundTrips trips;
  for (int i = 0; i < 5; ++i) trips.sent();
  EXPECT_TRUE(trips.received(0, 1ms));
  EXPECT_TRUE(trips.received(2, 1ms));
  EXPECT_TRUE(trips.received(1, 1ms));  // late
  EXPECT_TRUE(trips.received(2, 9ms));  // twice
  EXPECT_TRUE(trips.received(4, 1ms));
  EXPECT_FALSE(trips.received(5, 1ms));  // never sent
  EXPECT_EQ(trips.sent_count(), 5);
  EXPECT_EQ(trips.received_count(), 4);
  EXPECT_EQ(trips.lost(), 1);
  EXPECT_EQ(trips.duplicated(), 1);
  EXPECT_EQ(trips.out_of_order(), 1);
  EXPECT_EQ(trips.latencies().count(), 4);
  EXPECT_DOUBLE_EQ(trips.latencies().quantile_us(1), 1000);
}

}  // namespace
}  // namespace iotcloud::drivers::loadgen
