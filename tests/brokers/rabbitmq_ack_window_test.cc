#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/rabbitmq/ack_window.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using Action = AckWindow::Action;
using Kind = AckWindow::Kind;

AckWindow with_deliveries(std::uint64_t count) {
  AckWindow window;
  for (std::uint64_t tag = 1; tag <= count; ++tag) EXPECT_TRUE(window.delivered(tag));
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

TEST(AckWindowTest, GivesARunBackAtOnceSoThatItsOrderStays) {
  AckWindow window = with_deliveries(4);
  window.settle(1, Settlement::accept);
  for (const std::uint64_t tag : {2, 3, 4}) window.settle(tag, Settlement::retry);
  EXPECT_THAT(window.take(10), ElementsAre(Action{Kind::acknowledge, 1, true}, Action{Kind::requeue, 4, true}));
}

TEST(AckWindowTest, RetriesAndRejectsDoNotWait) {
  AckWindow window = with_deliveries(4);
  window.settle(2, Settlement::retry);
  window.settle(3, Settlement::reject);
  window.settle(4, Settlement::accept);
  EXPECT_THAT(window.take(10), ElementsAre(Action{Kind::requeue, 2, false}, Action{Kind::reject, 3, false}));
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
  EXPECT_FALSE(window.delivered(7)) << "a gap in the server's tags";
}

TEST(AckWindowTest, StartsAfreshOnANewChannel) {
  AckWindow window = with_deliveries(3);
  window.settle(2, Settlement::accept);
  window.clear();
  EXPECT_FALSE(window.has_news());
  EXPECT_TRUE(window.delivered(1));
}

}  // namespace
}  // namespace iotcloud::brokers::rabbitmq
