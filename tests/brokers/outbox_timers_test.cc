#include "iotcloud/brokers/client/outbox_timers.h"

#include <memory>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace iotcloud::brokers::client {
namespace {

using std::chrono::milliseconds;
using testing::ElementsAre;
using testing::IsEmpty;

class OutboxTimersTest : public testing::Test {
 protected:
  /// Adds a publisher whose messages expire after `deadline` (0: never).
  std::shared_ptr<Outbox> add_publisher(milliseconds deadline) {
    PublisherOptions options;
    options.capacity = 10;
    options.deadline = deadline;
    outboxes_.push_back(std::make_shared<Outbox>(Topic{"exchange", "topic", false}, options));
    return outboxes_.back();
  }
  bool add_message(Outbox& outbox) {
    outbox.add_waiting(outbox.accept(Message{}, now_));
    return timers_.note(outbox);
  }
  std::vector<std::shared_ptr<Outbox>> fire() {
    std::vector<std::shared_ptr<Outbox>> fired;
    timers_.fire(outboxes_, now_, [&](const std::shared_ptr<Outbox>& outbox) { fired.push_back(outbox); });
    return fired;
  }

  std::vector<std::shared_ptr<Outbox>> outboxes_;
  OutboxTimers timers_;
  Instant now_{};
};

TEST_F(OutboxTimersTest, TheEarliestOfAllIsNextAndSaidToBeNew) {
  const auto late = add_publisher(milliseconds(50)), early = add_publisher(milliseconds(20)),
             never = add_publisher(milliseconds(0));
  EXPECT_FALSE(add_message(*never));
  EXPECT_EQ(timers_.next(), Instant::max());
  EXPECT_TRUE(add_message(*late));
  EXPECT_TRUE(add_message(*early));
  EXPECT_FALSE(add_message(*late));
  EXPECT_EQ(timers_.next(), now_ + milliseconds(20));
}

TEST_F(OutboxTimersTest, OnlyThoseFireThatAreDueAndTheOthersAreNext) {
  const auto late = add_publisher(milliseconds(50)), early = add_publisher(milliseconds(20));
  add_message(*late);
  add_message(*early);
  now_ += milliseconds(19);
  EXPECT_THAT(fire(), IsEmpty());
  now_ += milliseconds(1);
  EXPECT_THAT(fire(), ElementsAre(early));
  EXPECT_TRUE(early->idle()) << "what was too old is still there";
  EXPECT_EQ(timers_.next(), Instant{} + milliseconds(50));
}

TEST_F(OutboxTimersTest, AMessageThatWasSentMeanwhileLeavesNothingToFire) {
  const auto outbox = add_publisher(milliseconds(20));
  outbox->ready = true;
  add_message(*outbox);
  outbox->take_next();
  now_ += milliseconds(20);
  EXPECT_THAT(fire(), IsEmpty());
  EXPECT_EQ(timers_.next(), Instant::max());
}

TEST_F(OutboxTimersTest, TheSecondMessageOfAPublisherIsNotForgotten) {
  const auto outbox = add_publisher(milliseconds(20));
  outbox->ready = true;
  add_message(*outbox);
  now_ += milliseconds(5);
  EXPECT_FALSE(add_message(*outbox));
  outbox->take_next();
  now_ += milliseconds(15);
  EXPECT_THAT(fire(), IsEmpty());
  EXPECT_EQ(timers_.next(), now_ + milliseconds(5));
  now_ += milliseconds(5);
  EXPECT_THAT(fire(), ElementsAre(outbox));
}

}  // namespace
}  // namespace iotcloud::brokers::client
