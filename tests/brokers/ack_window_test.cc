#include "iotcloud/brokers/client/ack_window.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace iotcloud::brokers::client {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using Action = AckWindow::Action;
using Kind = AckWindow::Kind;

Arrived numbered(std::uint64_t tag) {
  Arrived arrived;
  arrived.message.payload = Payload::copy(std::to_string(tag));
  arrived.tag = tag;
  return arrived;
}

/// A window whose messages are all handed on.
AckWindow with_deliveries(std::uint64_t count) {
  AckWindow window;
  for (std::uint64_t tag = 1; tag <= count; ++tag) {
    EXPECT_TRUE(window.delivered(numbered(tag)));
    EXPECT_EQ(window.next().tag, tag);
  }
  return window;
}

TEST(AckWindowTest, AcknowledgesARunWithOneMessage) {
  AckWindow window = with_deliveries(5);
  for (const std::uint64_t tag : {1, 2, 3}) EXPECT_TRUE(window.settle(tag, Settlement::accept));
  EXPECT_THAT(window.take(10), ElementsAre(Action{Kind::acknowledge, 3, true}));
  EXPECT_THAT(window.take(10), IsEmpty());
}

TEST(AckWindowTest, HoldsBackWhatIsBehindAnUnsettledOne) {
  AckWindow window = with_deliveries(4);
  window.settle(2, Settlement::accept);
  window.settle(3, Settlement::accept);
  EXPECT_THAT(window.take(10), IsEmpty());
  window.settle(1, Settlement::accept);
  EXPECT_THAT(window.take(10), ElementsAre(Action{Kind::acknowledge, 3, true}));
}

TEST(AckWindowTest, LosesPatienceWithOneThatStaysUnsettled) {
  AckWindow window = with_deliveries(5);
  for (const std::uint64_t tag : {2, 3, 5}) window.settle(tag, Settlement::accept);
  EXPECT_THAT(window.take(2), ElementsAre(Action{Kind::acknowledge, 2, false}, Action{Kind::acknowledge, 3, false},
                                          Action{Kind::acknowledge, 5, false}));
  window.settle(1, Settlement::accept);
  window.settle(4, Settlement::accept);
  EXPECT_THAT(window.take(2), ElementsAre(Action{Kind::acknowledge, 4, true})) << "each is told once";
}

TEST(AckWindowTest, ARetriedMessageComesAgainBeforeAllThatCameAfterIt) {
  AckWindow window = with_deliveries(3);
  EXPECT_TRUE(window.delivered(numbered(4)));
  EXPECT_TRUE(window.settle(3, Settlement::retry));
  EXPECT_TRUE(window.settle(2, Settlement::retry));
  EXPECT_THAT(window.take(0), IsEmpty()) << "the server is told nothing";
  for (const std::uint64_t tag : {2, 3, 4}) {
    const Arrived again = window.next();
    EXPECT_EQ(again.tag, tag);
    EXPECT_EQ(again.message.payload.text(), std::to_string(tag));
    EXPECT_EQ(again.redelivered, tag != 4);
  }
  EXPECT_EQ(window.waiting(), 0U);
}

TEST(AckWindowTest, ARetriedMessageIsAcknowledgedOnce) {
  AckWindow window = with_deliveries(2);
  window.settle(1, Settlement::retry);
  EXPECT_FALSE(window.settle(1, Settlement::accept)) << "it waits: nobody has it";
  window.settle(2, Settlement::accept);
  EXPECT_THAT(window.take(5), IsEmpty());
  window.settle(window.next().tag, Settlement::accept);
  EXPECT_THAT(window.take(5), ElementsAre(Action{Kind::acknowledge, 2, true}));
}

TEST(AckWindowTest, RejectsDoNotWait) {
  AckWindow window = with_deliveries(4);
  window.settle(3, Settlement::reject);
  window.settle(4, Settlement::accept);
  EXPECT_THAT(window.take(10), ElementsAre(Action{Kind::reject, 3, false}));
  EXPECT_EQ(window.settled(), 1U);
  EXPECT_THAT(window.take(0), ElementsAre(Action{Kind::acknowledge, 4, false}));
}

TEST(AckWindowTest, IgnoresWhatIsNotUnderWay) {
  AckWindow window = with_deliveries(2);
  EXPECT_FALSE(window.settle(0, Settlement::accept));
  EXPECT_FALSE(window.settle(3, Settlement::accept));
  EXPECT_TRUE(window.settle(1, Settlement::accept));
  EXPECT_FALSE(window.settle(1, Settlement::retry)) << "settled twice";
  window.take(0);
  EXPECT_FALSE(window.settle(1, Settlement::retry)) << "told already";
  EXPECT_FALSE(window.delivered(numbered(7))) << "a gap in the server's tags";
}

TEST(AckWindowTest, StartsAfreshOnANewChannel) {
  AckWindow window = with_deliveries(3);
  window.settle(2, Settlement::accept);
  window.clear();
  EXPECT_EQ(window.settled(), 0U);
  EXPECT_TRUE(window.delivered(numbered(1)));
}

}  // namespace
}  // namespace iotcloud::brokers::client
