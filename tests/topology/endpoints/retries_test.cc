#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/topology/endpoints/receiving/retries.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::IsEmpty;

class RetriesTest : public testing::Test {
 protected:
  /// A new message, named by its driver and number.
  ChannelMessage arrive(const std::string& driver) {
    brokers::Message message;
    message.driver_id = driver;
    ChannelMessage arrival(brokers::Delivery(std::move(message), false, nullptr, 0), nullptr);
    arrival.sequence = ++last_sequence_;
    return arrival;
  }
  /// It was emitted and its tuple failed.
  void fail(ChannelMessage arrival) {
    ++arrival.tries;
    retries_.add(std::move(arrival), now_);
  }
  /// What is emitted now; `done` says so at once of each.
  std::vector<std::uint64_t> take(bool done) {
    std::vector<std::uint64_t> taken;
    while (auto arrival = retries_.next(now_)) {
      taken.push_back(arrival->sequence);
      if (done) retries_.done(*arrival);
    }
    return taken;
  }
  bool hold(ChannelMessage arrival) { return retries_.hold(arrival); }

  Retries retries_;
  Retries::Instant now_{1h};
  std::uint64_t last_sequence_ = 0;
};

TEST_F(RetriesTest, WaitLongerAfterEachTryUpToFiveSeconds) {
  EXPECT_EQ(Retries::pause_after(1), 20ms);
  EXPECT_EQ(Retries::pause_after(2), 40ms);
  EXPECT_EQ(Retries::pause_after(8), 2560ms);
  EXPECT_EQ(Retries::pause_after(9), 5s);
  EXPECT_EQ(Retries::pause_after(1000), 5s);
}

TEST_F(RetriesTest, ComeWhenTheirTimeHasComeAndNotBefore) {
  fail(arrive("one"));
  EXPECT_EQ(retries_.due(), now_ + 20ms);
  now_ += 19ms;
  EXPECT_THAT(take(true), IsEmpty());
  now_ += 1ms;
  EXPECT_THAT(take(true), ElementsAre(1));
  EXPECT_TRUE(retries_.empty());
  EXPECT_EQ(retries_.due(), std::nullopt);
}

TEST_F(RetriesTest, HoldBackWhatTheSameDriverSendsBehindUntilTheyAreDone) {
  fail(arrive("one"));
  EXPECT_TRUE(hold(arrive("one")));
  now_ += 20ms;
  auto retried = retries_.next(now_);
  ASSERT_TRUE(retried);
  EXPECT_TRUE(hold(arrive("one")));
  EXPECT_THAT(take(false), IsEmpty());
  retries_.done(*retried);
  EXPECT_THAT(take(false), ElementsAre(2, 3));
  EXPECT_FALSE(hold(arrive("one")));
}

TEST_F(RetriesTest, LetOtherDriversGoOn) {
  fail(arrive("one"));
  EXPECT_FALSE(hold(arrive("two")));
}

TEST_F(RetriesTest, OfOneDriverAreTriedOneByOneInTheirOrder) {
  auto first = arrive("one");
  fail(arrive("one"));
  fail(std::move(first));  // failed later, came earlier
  EXPECT_TRUE(hold(arrive("one")));
  now_ += 1s;
  EXPECT_THAT(take(false), ElementsAre(1));
  EXPECT_THAT(take(false), IsEmpty());
  retries_.clear();

  auto third = arrive("one");
  fail(arrive("one"));
  fail(std::move(third));
  EXPECT_TRUE(hold(arrive("one")));
  now_ += 1s;
  EXPECT_THAT(take(true), ElementsAre(4, 5, 6));
  EXPECT_TRUE(retries_.empty());
}

TEST_F(RetriesTest, ThatFailAgainWaitAgainAndKeepTheirPlace) {
  fail(arrive("one"));
  EXPECT_TRUE(hold(arrive("one")));
  now_ += 20ms;
  auto retried = retries_.next(now_);
  ASSERT_TRUE(retried);
  fail(std::move(*retried));
  EXPECT_EQ(retries_.due(), now_ + 40ms);
  now_ += 39ms;
  EXPECT_THAT(take(true), IsEmpty());
  now_ += 1ms;
  EXPECT_THAT(take(true), ElementsAre(1, 2));
}

TEST_F(RetriesTest, HoldReleasedOnesBackAgainWhenOneBeforeThemFails) {
  auto under_way = arrive("one");
  fail(arrive("one"));
  EXPECT_TRUE(hold(arrive("one")));
  now_ += 20ms;
  auto retried = retries_.next(now_);
  ASSERT_TRUE(retried);
  retries_.done(*retried);  // message 3 may go
  fail(std::move(under_way));
  EXPECT_THAT(take(true), IsEmpty());
  now_ += 20ms;
  EXPECT_THAT(take(true), ElementsAre(1, 3));
}

TEST_F(RetriesTest, OfManyDriversComeByTheirTime) {
  fail(arrive("b"));
  now_ += 5ms;
  fail(arrive("a"));
  EXPECT_EQ(retries_.due(), now_ + 15ms);
  now_ += 1s;
  EXPECT_THAT(take(false), ElementsAre(1, 2));
}

}  // namespace
}  // namespace iotcloud::topology
