// How a reader of Kafka keeps its place in a partition.
#include "iotcloud/brokers/kafka/reading/progress.h"

#include <limits>
#include <string>

#include <gtest/gtest.h>

namespace iotcloud::brokers::kafka {
namespace {

constexpr std::int64_t log_end = 1000;

void arrive(Progress& progress, std::int64_t offset) {
  Message message;
  message.payload = Payload::copy(std::to_string(offset));
  progress.arrived(offset, std::move(message), progress.maybe_handed_on(offset, log_end));
}

std::string body(const Arrived& arrived) {
  return std::string(arrived.message.payload.text());
}

TEST(KafkaProgress, CommitsTheFirstOffsetThatIsNotSettled) {
  Progress progress({5, ""}, 0);
  for (int offset = 5; offset < 9; ++offset) arrive(progress, offset);
  const auto first = progress.next();
  const auto second = progress.next();
  progress.settle(second.tag, Settlement::accept);
  EXPECT_EQ(progress.to_commit(false)->offset, 5);
  progress.settle(first.tag, Settlement::accept);
  EXPECT_EQ(progress.to_commit(false)->offset, 7);
  EXPECT_FALSE(progress.to_commit(false)) << "that was committed already";
  progress.commit_failed();
  EXPECT_EQ(progress.to_commit(false)->offset, 7);
}

TEST(KafkaProgress, CountsOffsetsThatHoldNoMessage) {
  Progress progress({0, ""}, 0);
  arrive(progress, 3);
  arrive(progress, 10);
  progress.settle(progress.next().tag, Settlement::accept);
  EXPECT_EQ(progress.to_commit(false)->offset, 10);
  progress.settle(progress.next().tag, Settlement::accept);
  EXPECT_EQ(progress.to_commit(false)->offset, 11);
}

TEST(KafkaProgress, AGroupThatNeverReadStartsAtTheOldestAndSaysSoAtOnce) {
  Progress progress({}, 0);
  EXPECT_LT(progress.start(), 0);
  EXPECT_EQ(progress.to_commit(false)->offset, 0);
  arrive(progress, 0);
  EXPECT_FALSE(progress.next().redelivered);
}

TEST(KafkaProgress, AGroupWhosePlaceIsNotKnownCommitsNothingBeforeItsFirstRecordAndDoubtsAllThatIsThere) {
  Progress progress({-1, "", false}, 0);
  EXPECT_LT(progress.start(), 0);
  EXPECT_FALSE(progress.to_commit(false)) << "it would overwrite the group's place";
  EXPECT_FALSE(progress.to_commit(true));
  EXPECT_FALSE(progress.placed());
  arrive(progress, 40);
  EXPECT_EQ(progress.to_commit(false)->offset, 40);
  const auto first = progress.next();
  EXPECT_TRUE(first.redelivered);
  progress.settle(first.tag, Settlement::accept);
  EXPECT_EQ(progress.to_commit(true)->offset, 41);
  arrive(progress, log_end);
  EXPECT_FALSE(progress.next().redelivered);
}

TEST(KafkaProgress, TheNextReaderSkipsWhatWasSettledOutOfOrder) {
  Progress before({10, ""}, 0);
  for (int offset = 10; offset < 20; ++offset) arrive(before, offset);
  for (int i = 0; i < 8; ++i) {
    const auto arrived = before.next();
    if (i == 1 || (i >= 3 && i <= 5)) before.settle(arrived.tag, Settlement::accept);
  }
  Progress after(*before.to_commit(true), 0);
  EXPECT_EQ(after.start(), 10);
  for (int offset = 10; offset < 20; ++offset) {
    EXPECT_EQ(after.was_settled(offset), offset == 11 || (offset >= 13 && offset <= 15)) << offset;
  }
}

TEST(KafkaProgress, AfterAnOrderlyEndOnlyWhatWasHandedOnIsDoubtful) {
  Progress before({10, "iotcloud1 end 0 "}, 0);
  for (int offset = 10; offset < 20; ++offset) arrive(before, offset);
  for (int i = 0; i < 3; ++i) before.next();
  Progress after(*before.to_commit(true), 0);
  EXPECT_TRUE(after.maybe_handed_on(12, log_end));
  EXPECT_FALSE(after.maybe_handed_on(13, log_end));
}

TEST(KafkaProgress, AfterACrashEverythingThatWasThereIsDoubtful) {
  Progress before({10, ""}, 0);
  arrive(before, 10);
  Progress after(*before.to_commit(false), 0);
  EXPECT_TRUE(after.maybe_handed_on(10, 15));
  EXPECT_TRUE(after.maybe_handed_on(14, 99)) << "the end counts as it was at first";
  EXPECT_FALSE(after.maybe_handed_on(15, 99));
}

TEST(KafkaProgress, AnOrderlyEndTakesNoDoubtAwayThatACrashBeforeLeft) {
  const Committed crashed{10, "iotcloud1 on 0 "};
  for (const int read : {0, 1, 3}) {
    Progress between(crashed, 0);
    for (int offset = 10; offset < 10 + read; ++offset) {
      between.arrived(offset, Message{}, between.maybe_handed_on(offset, 15));
      between.settle(between.next().tag, Settlement::accept);
    }
    Progress after(*between.to_commit(true), 0);
    EXPECT_EQ(after.start(), 10 + read);
    const std::int64_t end = read == 0 ? 15 : 99;
    EXPECT_TRUE(after.maybe_handed_on(14, end)) << read;
    EXPECT_FALSE(after.maybe_handed_on(15, end)) << read;
  }
}

TEST(KafkaProgress, WhatThisProcessHandedOnBeforeIsDoubtful) {
  Progress progress({}, 7);
  EXPECT_TRUE(progress.maybe_handed_on(6, log_end));
  EXPECT_FALSE(progress.maybe_handed_on(7, log_end));
}

TEST(KafkaProgress, ForeignTextBesideAnOffsetMeansNothing) {
  for (const char* text : {"", "hello", "iotcloud1 ", "iotcloud1 end", "iotcloud1 end x ", "iotcloud1 end -5 3,",
                           "iotcloud1 end 99999999999999999999 ", "iotcloud1 end 5 7-3,", "iotcloud1 end 5 a-b,"}) {
    Progress progress({10, text}, 0);
    EXPECT_EQ(progress.start(), 10) << text;
    EXPECT_FALSE(progress.was_settled(17)) << text;
  }
}

TEST(KafkaProgress, NumbersThatNoPartitionReachesMeanNothing) {
  constexpr auto last = std::numeric_limits<std::int64_t>::max();
  constexpr std::int64_t far = std::int64_t{1} << 60;
  const std::string text = "iotcloud1 end " + std::to_string(far) + " 0-" + std::to_string(far) + ",";
  const Progress beyond({last, text}, 7);
  EXPECT_EQ(beyond.handed_on(), 7);
  EXPECT_FALSE(beyond.was_settled(last));
  EXPECT_TRUE(beyond.wants_log_end()) << "whoever wrote that is not believed to have ended in order";
  const Progress farthest({far, text}, 7);
  EXPECT_EQ(farthest.handed_on(), 2 * far);
  EXPECT_TRUE(farthest.was_settled(2 * far));
  EXPECT_FALSE(farthest.was_settled(2 * far + 1));
}

TEST(KafkaProgress, TheTextStaysWithinWhatAServerTakes) {
  Progress progress({0, ""}, 0);
  for (int offset = 0; offset < 20'000; ++offset) arrive(progress, offset);
  for (int offset = 0; offset < 20'000; ++offset) {
    const auto arrived = progress.next();
    if (offset % 2 == 1) progress.settle(arrived.tag, Settlement::accept);
  }
  const auto commit = progress.to_commit(true);
  EXPECT_EQ(commit->offset, 0);
  EXPECT_LE(commit->metadata.size(), 4096U);
  EXPECT_TRUE(Progress(*commit, 0).was_settled(1));
}

TEST(KafkaProgress, WhatIsReturnedComesAgainInOrderAndFlagged) {
  Progress progress({}, 0);
  for (int offset = 0; offset < 4; ++offset) arrive(progress, offset);
  progress.next();
  const auto second = progress.next();
  progress.next();
  progress.settle(second.tag, Settlement::accept);
  progress.return_all();
  EXPECT_EQ(progress.unsettled(), 3U);
  const auto again = progress.next();
  EXPECT_EQ(body(again), "0");
  EXPECT_TRUE(again.redelivered);
  EXPECT_EQ(body(progress.next()), "2");
  const auto fresh = progress.next();
  EXPECT_EQ(body(fresh), "3");
  EXPECT_FALSE(fresh.redelivered);
}

TEST(KafkaProgress, WhatNeedsNoHandlingIsCommittedInItsTurn) {
  Progress progress({}, 0);
  arrive(progress, 0);
  progress.skipped(1);
  EXPECT_EQ(progress.to_commit(false)->offset, 0);
  progress.settle(progress.next().tag, Settlement::accept);
  EXPECT_EQ(progress.to_commit(false)->offset, 2);
  EXPECT_EQ(progress.size(), 0U);
}

}  // namespace
}  // namespace iotcloud::brokers::kafka
