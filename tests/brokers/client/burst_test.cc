// When what a handler publishes may wait for what the next one does.
#include "iotcloud/brokers/client/burst.h"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>

#include <gtest/gtest.h>

#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::client {
namespace {

using std::chrono::microseconds;

class HandClock final : public config::Clock {
 public:
  Instant now() const override { return now_; }
  std::int64_t wall_ms() const override { return 0; }
  void advance(microseconds by) { now_ += by; }

 private:
  Instant now_{};
};

class BurstTest : public testing::Test {
 protected:
  HandClock clock_;
};

TEST_F(BurstTest, ALoneMessageIsNeverHeldBackNorMeasured) {
  Burst burst(clock_);
  burst.before_handler(false, true);
  EXPECT_EQ(Burst::going_on(), nullptr);
  EXPECT_EQ(burst.after_handler(), std::nullopt);
}

TEST_F(BurstTest, HoldsBackUntilTheLastMessage) {
  Burst burst(clock_);
  burst.before_handler(true, true);
  EXPECT_EQ(Burst::going_on(), &burst);
  EXPECT_EQ(burst.after_handler(), true);
  burst.before_handler(false, true);
  EXPECT_EQ(Burst::going_on(), nullptr);
}

TEST_F(BurstTest, AHandlerThatWasSlowHoldsNothingBackUntilItIsQuickAgain) {
  Burst burst(clock_);
  burst.before_handler(true, true);
  clock_.advance(microseconds(200));
  EXPECT_EQ(burst.after_handler(), false);
  burst.before_handler(true, false);
  EXPECT_EQ(Burst::going_on(), nullptr);
  clock_.advance(microseconds(5));
  EXPECT_EQ(burst.after_handler(), true);
  burst.before_handler(true, true);
  EXPECT_EQ(Burst::going_on(), &burst);
}

TEST_F(BurstTest, SendsNowAndThenInALongBurst) {
  Burst burst(clock_);
  int longest = 0;
  int held_back = 0;
  for (int i = 0; i < 100; ++i) {
    burst.before_handler(true, true);
    held_back = Burst::going_on() != nullptr ? held_back + 1 : 0;
    longest = std::max(longest, held_back);
    clock_.advance(microseconds(50));
    burst.after_handler();
  }
  EXPECT_GT(longest, 1);
  EXPECT_LE(longest, 8) << "0.3 ms, and one handler more";
}

TEST_F(BurstTest, EndsWithItsScope) {
  {
    Burst outer(clock_);
    outer.before_handler(true, true);
    {
      Burst inner(clock_);
      EXPECT_EQ(Burst::going_on(), nullptr);
    }
    EXPECT_EQ(Burst::going_on(), &outer);
  }
  EXPECT_EQ(Burst::going_on(), nullptr);
}

}  // namespace
}  // namespace iotcloud::brokers::client
