#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/gateway/host/losses.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::gateway {
namespace {

using ::testing::IsEmpty;
using ::testing::SizeIs;
using namespace std::chrono_literals;

class LossesTest : public ::testing::Test {
 protected:
  std::vector<LosingChannel> look() {
    losses_.begin();
    losses_.see("one"_instance, "readings", tally_.losses());
    return losses_.end();
  }
  tests::HandClock clock_;
  Losses losses_{clock_};
  ChannelTally tally_;
};

TEST_F(LossesTest, AChannelLosesMessagesUntilItHasLostNoneForAWhile) {
  tally_.done();
  tally_.refused("not taken: would_block");
  EXPECT_THAT(look(), IsEmpty()) << "nothing is lost";
  tally_.lost("dropped: superseded", 3);
  const auto since = clock_.wall_ms();
  const auto losing = look();
  ASSERT_THAT(losing, SizeIs(1));
  EXPECT_EQ(losing[0], (LosingChannel{"one"_instance, "readings", "dropped: superseded", since}));
  clock_.advance(Losses::quiet - 1ms);
  EXPECT_EQ(look(), losing) << "the same as long as it lasts";
  tally_.lost("dropped: deadline");
  clock_.advance(1ms);
  ASSERT_THAT(look(), SizeIs(1));
  clock_.advance(Losses::quiet);
  EXPECT_THAT(look(), IsEmpty());
  tally_.lost("dropped: deadline");
  EXPECT_EQ(look().at(0).since_ms, clock_.wall_ms());
}

TEST_F(LossesTest, AChannelThatWasOpenedAnewHasLostNothing) {
  tally_.lost("dropped: superseded", 5);
  EXPECT_THAT(look(), SizeIs(1));
  losses_.begin();
  losses_.see("one"_instance, "readings", {});
  EXPECT_THAT(losses_.end(), IsEmpty());
  losses_.begin();
  EXPECT_THAT(losses_.end(), IsEmpty()) << "nor has one that is gone";
}

TEST(ChannelTally, CountsWhatBecameOfMessagesAndKeepsItsSize) {
  ChannelTally tally;
  tally.done();
  for (std::size_t i = 0; i < ChannelTally::most_fates + 8; ++i) tally.lost("refused: " + std::to_string(i));
  const auto counts = tally.counts();
  EXPECT_EQ(counts.done, 1);
  EXPECT_THAT(counts.lost, SizeIs(ChannelTally::most_fates + 1));
  EXPECT_EQ(counts.lost.at("others"), 8);
}

}  // namespace
}  // namespace iotcloud::gateway
