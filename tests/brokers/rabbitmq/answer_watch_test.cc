// When a server that does not answer is left.
#include "iotcloud/brokers/rabbitmq/answer_watch.h"

#include <chrono>
#include <optional>

#include <gtest/gtest.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

using std::chrono::milliseconds;
using std::chrono::minutes;
using std::chrono::seconds;

class AnswerWatchTest : public testing::Test {
 protected:
  AnswerWatch watch_{seconds(10)};
  AnswerWatch::Instant now_{std::chrono::hours(1)};
};

TEST_F(AnswerWatchTest, OnlyTheSameMessageForTheWholeLimitIsTooLong) {
  EXPECT_EQ(watch_.overdue(1, now_), std::nullopt);
  EXPECT_EQ(watch_.overdue(1, now_ += milliseconds(9999)), std::nullopt);
  EXPECT_EQ(watch_.overdue(2, now_ += milliseconds(1)), std::nullopt) << "the first one was answered";
  EXPECT_EQ(watch_.overdue(2, now_ += seconds(10)), seconds(10));
}

TEST_F(AnswerWatchTest, ThePatienceDoublesUpToEightTimesAndIsForgottenAfterAMinute) {
  for (const int expected : {10, 20, 40, 80, 80}) {
    watch_.overdue(1, now_);
    EXPECT_EQ(watch_.overdue(1, now_ += seconds(expected - 1)), std::nullopt) << expected;
    EXPECT_EQ(watch_.overdue(1, now_ += seconds(1)), seconds(expected));
  }
  watch_.rest(now_ += minutes(2));
  watch_.overdue(1, now_);
  EXPECT_EQ(watch_.overdue(1, now_ += seconds(10)), seconds(10));
}

TEST_F(AnswerWatchTest, WhileNoAnswerIsExpectedNoTimePasses) {
  watch_.overdue(1, now_);
  watch_.rest(now_ += seconds(9));
  EXPECT_EQ(watch_.overdue(1, now_ += seconds(9)), std::nullopt);
  EXPECT_EQ(watch_.overdue(1, now_ += seconds(9)), std::nullopt);
  EXPECT_EQ(watch_.overdue(1, now_ += seconds(1)), seconds(10));
}

}  // namespace
}  // namespace iotcloud::brokers::rabbitmq
