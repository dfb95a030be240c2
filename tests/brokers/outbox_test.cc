#include "iotcloud/brokers/client/outbox.h"

#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace iotcloud::brokers::client {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class OutboxTest : public testing::Test {
 protected:
  Outbox& make(WhenFull when_full, std::size_t capacity, milliseconds deadline = milliseconds(0)) {
    PublisherOptions options;
    options.when_full = when_full;
    options.capacity = capacity;
    options.deadline = deadline;
    outbox_ = std::make_unique<Outbox>(Topic{"exchange", "topic", false}, options);
    outbox_->ready = true;
    return *outbox_;
  }
  void add(int count) {
    for (int i = 0; i < count; ++i) outbox_->add_waiting(outbox_->accept(Message{}, now_));
  }
  /// Takes all that may be sent now.
  std::vector<AcceptedMessage> send() {
    std::vector<AcceptedMessage> sent;
    while (!outbox_->idle() && outbox_->may_send()) sent.push_back(outbox_->take_next());
    return sent;
  }
  std::vector<Outbox::Event> events() {
    bool writable = false;
    return outbox_->take_events(writable);
  }
  /// Makes the topic proven, with nothing under way.
  void prove() {
    add(1);
    outbox_->confirmed(send().at(0).number);
    events();
  }

  std::unique_ptr<Outbox> outbox_;
  Instant now_{};
};

TEST_F(OutboxTest, SendsOneMessageAloneUntilTheTopicIsProven) {
  Outbox& outbox = make(WhenFull::block, 10);
  add(5);
  std::vector<AcceptedMessage> sent = send();
  ASSERT_EQ(sent.size(), 1U);
  outbox.confirmed(sent[0].number);
  EXPECT_EQ(send().size(), 4U);
}

TEST_F(OutboxTest, TriesAReturnedMessageAgainAfterAWhileBeforeTheOthers) {
  Outbox& outbox = make(WhenFull::block, 10);
  add(3);
  outbox.returned(std::move(send().at(0)), now_);
  EXPECT_FALSE(outbox.may_send());
  ASSERT_TRUE(outbox.next_timer());
  now_ = *outbox.next_timer();
  outbox.fire_timer(now_);
  std::vector<AcceptedMessage> again = send();
  ASSERT_EQ(again.size(), 1U);
  EXPECT_EQ(again[0].number, 1U);
  EXPECT_FALSE(again[0].resent) << "nobody got it: it is no duplicate";
  EXPECT_TRUE(events().empty());
}

TEST_F(OutboxTest, TriesWhatTheServerCouldNotStoreAgainAfterAWhileAndMarksIt) {
  Outbox& outbox = make(WhenFull::block, 10);
  prove();
  add(3);
  for (AcceptedMessage& accepted : send()) outbox.put_off(std::move(accepted), now_);
  EXPECT_FALSE(outbox.may_send());
  ASSERT_TRUE(outbox.next_timer());
  now_ = *outbox.next_timer();
  outbox.fire_timer(now_);
  const std::vector<AcceptedMessage> again = send();
  ASSERT_EQ(again.size(), 1U) << "alone, until it got through";
  EXPECT_TRUE(again[0].resent) << "another queue may have stored it";
  outbox.confirmed(again[0].number);
  EXPECT_EQ(send().size(), 2U);
}

TEST_F(OutboxTest, WhatWasLostStaysMarkedWhenItComesBackUnreadLater) {
  Outbox& outbox = make(WhenFull::block, 10);
  add(1);
  outbox.lost(std::move(send().at(0)));
  outbox.disconnected();
  outbox.ready = true;
  outbox.returned(std::move(send().at(0)), now_);
  now_ = outbox.next_timer().value();
  outbox.fire_timer(now_);
  const std::vector<AcceptedMessage> again = send();
  ASSERT_EQ(again.size(), 1U);
  EXPECT_TRUE(again[0].resent) << "it may have been read before the connection was lost";
}

TEST_F(OutboxTest, PutsWhatWasLostBackInOrderAndMarksIt) {
  Outbox& outbox = make(WhenFull::block, 10);
  prove();
  add(4);
  std::vector<AcceptedMessage> sent = send();
  ASSERT_EQ(sent.size(), 4U);
  add(1);
  outbox.confirmed(sent[0].number);
  for (std::size_t i = 1; i < 4; ++i) outbox.lost(std::move(sent[i]));
  outbox.disconnected();
  EXPECT_FALSE(outbox.may_send());
  outbox.ready = true;
  std::vector<std::uint64_t> numbers;
  std::vector<bool> marks;
  while (!outbox.idle()) {
    const AcceptedMessage next = send().at(0);
    numbers.push_back(next.number);
    marks.push_back(next.resent);
    outbox.confirmed(next.number);
    if (!outbox.idle()) {
      for (AcceptedMessage& more : send()) {
        numbers.push_back(more.number);
        marks.push_back(more.resent);
      }
    }
  }
  EXPECT_EQ(numbers, (std::vector<std::uint64_t>{3, 4, 5, 6}));
  EXPECT_EQ(marks, (std::vector<bool>{true, true, true, false}));
}

TEST_F(OutboxTest, BlockCountsWhatIsUnderWay) {
  Outbox& outbox = make(WhenFull::block, 3);
  prove();
  add(3);
  std::vector<AcceptedMessage> sent = send();
  EXPECT_EQ(sent.size(), 3U);
  EXPECT_FALSE(outbox.has_room());
  outbox.refuse_room();
  bool writable = false;
  outbox.confirmed(sent[0].number);
  EXPECT_EQ(outbox.take_events(writable).size(), 1U);
  EXPECT_TRUE(writable);
  EXPECT_TRUE(outbox.has_room());
}

TEST_F(OutboxTest, KeepNewestDropsTheOldestThatWaitsNeverWhatIsUnderWay) {
  Outbox& outbox = make(WhenFull::keep_newest, 2);
  prove();
  add(2);
  EXPECT_EQ(send().size(), 2U);  // numbers 2 and 3
  add(3);                        // 4, 5, 6
  EXPECT_TRUE(outbox.has_room());
  const auto dropped = events();
  ASSERT_EQ(dropped.size(), 1U);
  EXPECT_EQ(dropped[0].number, 4U);
  EXPECT_EQ(dropped[0].outcome, Outcome::dropped);
  EXPECT_EQ(dropped[0].reason, "superseded");
}

TEST_F(OutboxTest, SaysWhenMessagesWereDroppedForWantOfAReader) {
  Outbox& outbox = make(WhenFull::keep_newest, 1);
  add(1);
  outbox.returned(std::move(send().at(0)), now_);
  add(1);
  const auto dropped = events();
  ASSERT_EQ(dropped.size(), 1U);
  EXPECT_EQ(dropped[0].number, 1U);
  EXPECT_EQ(dropped[0].reason, "no_reader");
}

TEST_F(OutboxTest, WhatNobodyReadsIsTriedOftenAtFirstAndLaterRarely) {
  Outbox& outbox = make(WhenFull::block, 10);
  add(1);
  const auto next_try = [&] {
    outbox.returned(std::move(send().at(0)), now_);
    const milliseconds wait = std::chrono::duration_cast<milliseconds>(outbox.next_timer().value() - now_);
    now_ += wait;
    outbox.fire_timer(now_);
    return wait;
  };
  const Instant began = now_;
  EXPECT_LE(next_try(), milliseconds(20));
  while (now_ - began < seconds(1)) EXPECT_LE(next_try(), milliseconds(200));
  while (now_ - began < seconds(10)) next_try();
  for (int i = 0; i < 10; ++i) EXPECT_GE(next_try(), milliseconds(500));
  prove();
  add(1);
  EXPECT_LE(next_try(), milliseconds(20)) << "another time";
}

TEST_F(OutboxTest, DropsWhatGrewTooOld) {
  Outbox& outbox = make(WhenFull::block, 10, milliseconds(100));
  outbox.ready = false;
  add(1);
  now_ += milliseconds(60);
  add(1);
  ASSERT_TRUE(outbox.next_timer());
  EXPECT_EQ(*outbox.next_timer() - now_, milliseconds(40));
  now_ += milliseconds(40);
  outbox.fire_timer(now_);
  const auto dropped = events();
  ASSERT_EQ(dropped.size(), 1U);
  EXPECT_EQ(dropped[0].number, 1U);
  EXPECT_EQ(dropped[0].reason, "deadline");
  EXPECT_FALSE(outbox.idle());
}

TEST_F(OutboxTest, GivesEveryMessageOneOutcomeWhenClosed) {
  Outbox& outbox = make(WhenFull::block, 10);
  prove();
  add(2);
  std::vector<AcceptedMessage> sent = send();
  outbox.ready = false;
  add(2);
  outbox.close({sent[0].number, sent[1].number});
  const auto all = events();
  ASSERT_EQ(all.size(), 4U);
  for (const auto& event : all) EXPECT_EQ(event.outcome, Outcome::unknown);
  outbox.reported(all.size() + 1);  // and the one that proved the topic
  EXPECT_EQ(outbox.pending(), 0U);
}

TEST(BackoffTest, DoublesUpToItsLimitWithinHalf) {
  Backoff backoff(milliseconds(100), seconds(1));
  for (const int expected : {100, 200, 400, 800, 1000, 1000}) {
    const milliseconds next = backoff.next();
    EXPECT_GE(next.count(), expected / 2);
    EXPECT_LE(next.count(), expected);
  }
  backoff.reset();
  EXPECT_LE(backoff.next().count(), 100);
}

}  // namespace
}  // namespace iotcloud::brokers::client
