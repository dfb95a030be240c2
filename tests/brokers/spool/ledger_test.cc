// Each number gets its outcome, in whatever order the outcomes arrive.
#include "iotcloud/brokers/spool/ledger.h"

#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace iotcloud::brokers::spool {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::Pair;

/// Takes the numbers with an outcome, each once.
std::vector<std::pair<std::uint64_t, Outcome>> taken(Ledger& ledger) {
  std::vector<std::pair<std::uint64_t, Outcome>> all;
  const auto events = ledger.take_events();
  for (const auto& event : events) {
    for (std::uint64_t i = 0; i < event.count; ++i) {
      all.emplace_back(event.first_number == 0 ? 0 : event.first_number + i, event.outcome);
    }
  }
  ledger.reported(events);
  return all;
}

TEST(SpoolLedgerTest, TheMarkIsWhereTheFirstIsThatIsNotDoneWith) {
  Ledger ledger(1, 1);
  for (int i = 0; i < 3; ++i) {
    ledger.note_stored();
    ledger.note_sent(10);
  }
  EXPECT_EQ(ledger.mark(), 1u);
  ledger.note_answered(2, Outcome::confirmed, "");
  EXPECT_EQ(ledger.mark(), 1u);
  ledger.note_answered(1, Outcome::refused, "no");
  EXPECT_EQ(ledger.mark(), 3u);
  EXPECT_EQ(ledger.under_way_bytes(), 10u);
  EXPECT_EQ(ledger.pending(), 3u) << "none is reported yet";
  EXPECT_THAT(taken(ledger), ElementsAre(Pair(2, Outcome::confirmed), Pair(1, Outcome::refused)));
  EXPECT_EQ(ledger.pending(), 1u);
}

TEST(SpoolLedgerTest, TellsWhichNumbersAreBelowARecord) {
  Ledger ledger(5, 7);
  EXPECT_EQ(ledger.number_before(7), 0u) << "what is there is an earlier process's";
  ledger.note_stored();                             // record 7: number 1
  ledger.settled_unstored(Outcome::refused, "no");  // number 2
  ledger.settled_unstored(Outcome::refused, "no");  // number 3
  ledger.note_stored();                             // record 8: number 4
  ledger.note_stored();                             // record 9: number 5
  ledger.settled_unstored(Outcome::refused, "no");  // number 6
  EXPECT_EQ(ledger.number_before(6), 0u);
  EXPECT_EQ(ledger.number_before(7), 0u);
  EXPECT_EQ(ledger.number_before(8), 3u);
  EXPECT_EQ(ledger.number_before(9), 4u);
  EXPECT_EQ(ledger.number_before(10), 6u);
  for (int i = 0; i < 4; ++i) ledger.note_sent(1);
  for (std::uint64_t i = 1; i <= 4; ++i) ledger.note_answered(i, Outcome::confirmed, "");
  EXPECT_EQ(ledger.number_before(ledger.mark()), 4u) << "record 9 is not done with";
}

TEST(SpoolLedgerTest, MessagesOfAnEarlierProcessHaveNoNumber) {
  Ledger ledger(5, 7);
  EXPECT_EQ(ledger.pending(), 2u);
  ledger.note_stored();
  EXPECT_TRUE(ledger.is_old(6));
  EXPECT_FALSE(ledger.is_old(7));
  for (int i = 0; i < 3; ++i) ledger.note_sent(1);
  for (std::uint64_t i = 1; i <= 3; ++i) ledger.note_answered(i, Outcome::confirmed, "");
  EXPECT_THAT(taken(ledger),
              ElementsAre(Pair(0, Outcome::confirmed), Pair(0, Outcome::confirmed), Pair(1, Outcome::confirmed)));
  EXPECT_EQ(ledger.mark(), 8u);
  EXPECT_EQ(ledger.pending(), 0u);
}

TEST(SpoolLedgerTest, MessagesThatWereNeverStoredHaveTheirNumbersToo) {
  Ledger ledger(1, 1);
  ledger.note_stored();                                 // 1
  ledger.settled_unstored(Outcome::refused, "large");   // 2
  ledger.settled_unstored(Outcome::refused, "larger");  // 3
  ledger.note_stored();                                 // 4
  ledger.note_stored();                                 // 5
  EXPECT_THAT(taken(ledger), ElementsAre(Pair(2, Outcome::refused), Pair(3, Outcome::refused)));
  EXPECT_EQ(ledger.drop_below(3, "spool_full"), 2u);
  EXPECT_THAT(taken(ledger), ElementsAre(Pair(1, Outcome::dropped), Pair(4, Outcome::dropped)));
  ledger.note_sent(1);
  ledger.note_answered(1, Outcome::confirmed, "");
  EXPECT_THAT(taken(ledger), ElementsAre(Pair(5, Outcome::confirmed)));
  EXPECT_EQ(ledger.pending(), 0u);
}

TEST(SpoolLedgerTest, WhatIsUnderWayIsNotDropped) {
  Ledger ledger(1, 1);
  for (int i = 0; i < 4; ++i) ledger.note_stored();
  ledger.note_sent(1);
  EXPECT_EQ(ledger.drop_below(4, "spool_full"), 2u);
  EXPECT_EQ(ledger.mark(), 1u);
  EXPECT_EQ(ledger.unsent(), 4u);
  ledger.note_answered(1, Outcome::confirmed, "");
  EXPECT_EQ(ledger.mark(), 4u);
  EXPECT_THAT(taken(ledger),
              ElementsAre(Pair(2, Outcome::dropped), Pair(3, Outcome::dropped), Pair(1, Outcome::confirmed)));
}

TEST(SpoolLedgerTest, WhatTheInnerPublisherDoesNotTakeIsNextAgain) {
  Ledger ledger(1, 1);
  ledger.note_stored();
  ledger.note_stored();
  ledger.note_sent(1);
  EXPECT_FALSE(ledger.note_not_taken("spool_full"));
  EXPECT_EQ(ledger.unsent(), 1u);
  EXPECT_EQ(ledger.under_way(), 0u);
  ledger.note_sent(1);
  ledger.drop_below(3, "spool_full");
  EXPECT_TRUE(ledger.note_not_taken("spool_full")) << "newer ones are gone already";
  EXPECT_THAT(taken(ledger), ElementsAre(Pair(2, Outcome::dropped), Pair(1, Outcome::dropped)));
  EXPECT_TRUE(ledger.all_sent());
}

TEST(SpoolLedgerTest, ClosingTellsOfEachMessageOfThisProcessOnce) {
  Ledger ledger(1, 3);
  for (int i = 0; i < 4; ++i) ledger.note_stored();
  for (int i = 0; i < 4; ++i) ledger.note_sent(1);
  ledger.note_answered(4, Outcome::confirmed, "");
  ledger.note_answered(3, Outcome::unknown, "closed");
  EXPECT_THAT(taken(ledger), ElementsAre(Pair(2, Outcome::confirmed)));
  ledger.close("spooled");
  EXPECT_THAT(taken(ledger),
              ElementsAre(Pair(1, Outcome::unknown), Pair(3, Outcome::unknown), Pair(4, Outcome::unknown)));
  EXPECT_EQ(ledger.mark(), 1u);
}

TEST(SpoolLedgerTest, AnAnswerToNothingIsIgnored) {
  Ledger ledger(1, 1);
  ledger.note_answered(1, Outcome::confirmed, "");
  ledger.note_stored();
  ledger.note_sent(1);
  ledger.note_answered(0, Outcome::confirmed, "");
  ledger.note_answered(2, Outcome::confirmed, "");
  EXPECT_THAT(taken(ledger), IsEmpty());
  EXPECT_EQ(ledger.mark(), 1u);
}

}  // namespace
}  // namespace iotcloud::brokers::spool
