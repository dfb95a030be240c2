#include <cstdio>
#include <fstream>
#include <stdexcept>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <iotcloud/bench/paper/application/order.h>
#include <iotcloud/bench/paper/application/point.h>

namespace iotcloud::bench::paper {
namespace {

constexpr std::int64_t ms = 1'000'000;

Order order() {
  return {
      .id = 7, .size = 100, .rate = 10, .drivers = 4, .start_ns = 500 * ms, .from_ns = 800 * ms, .until_ns = 1500 * ms};
}

TEST(Order, SpreadsTheDriversEvenlyOverAPeriod) {
  EXPECT_EQ(order().intended_ns(0, 0), 500 * ms);
  EXPECT_EQ(order().intended_ns(1, 0), 525 * ms);
  EXPECT_EQ(order().intended_ns(3, 2), 775 * ms);
}

TEST(Order, HasTheMessagesThatAreDueBeforeItsEnd) {
  EXPECT_EQ(order().messages(0), 10);  // at 500, 600, ... 1400 ms
  EXPECT_EQ(order().messages(3), 10);  // at 575, ... 1475 ms
  Order longer = order();
  longer.until_ns += 1;
  EXPECT_EQ(longer.messages(0), 11);
  Order none = order();
  none.until_ns = none.start_ns;
  EXPECT_EQ(none.messages(0), 0);
}

TEST(Order, IsReadFromAFile) {
  const std::string file = testing::TempDir() + "order";
  std::ofstream(file) << "3 60000 20 4 1000 2000 3000 4000\n";
  const auto read = read_order(file);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->id, 3);
  EXPECT_EQ(read->size, 60000);
  EXPECT_EQ(read->rate, 20);
  EXPECT_EQ(read->drivers, 4);
  EXPECT_EQ(read->start_ns, 1000);
  EXPECT_EQ(read->from_ns, 2000);
  EXPECT_EQ(read->until_ns, 3000);
  EXPECT_EQ(read->patience_ns, 4000);
  std::ofstream(file) << "3 60000 20\n";
  EXPECT_THROW(read_order(file), std::runtime_error);
  std::remove(file.c_str());
  EXPECT_FALSE(read_order(file));
}

TEST(Point, LeavesTheWarmUpOutAndCountsALateMessage) {
  Point point(order());
  point.joined(3);
  for (int message = 0; message < 3; ++message) point.sent();
  point.came_back(500 * ms, 900 * ms);  // warm-up, although it came later
  point.came_back(900 * ms, 903 * ms);
  EXPECT_FALSE(point.complete(1));
  point.came_back(1400 * ms, 1600 * ms);  // after the end: delayed messages count
  EXPECT_TRUE(point.complete(1));
  EXPECT_FALSE(point.complete(2));
  const auto report = nlohmann::json::parse(point.report());
  EXPECT_EQ(report["order"], 7);
  EXPECT_EQ(report["n"], 2);
  EXPECT_EQ(report["in_time"], 2);
  EXPECT_EQ(report["planned"], 3);
  EXPECT_EQ(report["came_back"], 3);
  EXPECT_DOUBLE_EQ(report["max_us"], 200'000);
  EXPECT_DOUBLE_EQ(report["mean_us"], 101'500);
}

TEST(Point, GivesUpBeforeTheBrokersMemoryIsFull) {
  Order big = order();
  big.size = 1'000'000;
  Point point(big);
  point.joined(1000);
  for (int message = 0; message < 134; ++message) point.sent();
  EXPECT_FALSE(point.overrun());
  point.sent();
  EXPECT_TRUE(point.overrun());
  EXPECT_FALSE(point.complete(1));
  for (int message = 0; message < 135; ++message) point.came_back(0, 1);
  EXPECT_TRUE(point.complete(1));
}

}  // namespace
}  // namespace iotcloud::bench::paper
