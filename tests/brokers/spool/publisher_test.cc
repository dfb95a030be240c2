// A publisher with a spool loses no accepted message, whatever happens to broker, disk and process.
#include <algorithm>
#include <future>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/spool/publisher_fixture.h"
#include <iotcloud/config/error.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::brokers::spool {
namespace {

using testing::ElementsAre;
using tests::eventually;

TEST_F(SpoolPublisherTest, SendsWhatItAcceptsInOrderAndReportsEachOnce) {
  const auto subscription = subscribe();
  auto publisher = this->publisher();
  send(*publisher, 1, 500);
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(publisher->pending(), 0u);
  ASSERT_TRUE(received_are(500));
  EXPECT_EQ(bodies(), numbered(1, 500));
  for (const auto& [body, redelivered] : received()) EXPECT_FALSE(redelivered) << body;
  EXPECT_EQ(outcomes_.numbers(), 500u);
  for (std::uint64_t i = 1; i <= 500; ++i) EXPECT_EQ(outcomes_.of(i).first, Outcome::confirmed);
  publisher.reset();
  EXPECT_FALSE(std::filesystem::exists(spool_.folder)) << "nothing is left";
}

TEST_F(SpoolPublisherTest, WhatComesWhileTheBrokerIsAwayWaitsOnDiskAndIsSentInOrder) {
  const auto subscription = subscribe();
  options_.capacity = 10;
  const auto publisher = this->publisher();
  send(*publisher, 1, 20);
  ASSERT_TRUE(publisher->drain(patience));
  server().stop();
  send(*publisher, 21, 2000);
  EXPECT_EQ(publisher->pending(), 1980u);
  EXPECT_EQ(metric("iotcloud_spool_messages"), 1980);
  EXPECT_GT(metric("iotcloud_spool_bytes"), 0);
  server().start();
  ASSERT_TRUE(publisher->drain(patience));
  send(*publisher, 2001, 2010);
  ASSERT_TRUE(received_are(2010));
  EXPECT_EQ(bodies(), numbered(1, 2010));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes_.count(Outcome::confirmed), 2010u);
  EXPECT_EQ(metric("iotcloud_spool_messages"), 0);
}

TEST_F(SpoolPublisherTest, SeveralThreadsMayPublishWhileTheBrokerComesAndGoes) {
  const auto subscription = subscribe();
  options_.capacity = 16;
  spool_.max_bytes = 4 << 20;
  const auto publisher = this->publisher();
  constexpr int threads = 4;
  constexpr int each = 500;
  {
    std::vector<std::jthread> senders;
    for (int t = 0; t < threads; ++t) {
      senders.emplace_back([&publisher, t] {
        for (int i = 0; i < each; ++i) {
          EXPECT_EQ(publisher->publish(sample(std::to_string(t) + "." + std::to_string(1000 + i))),
                    PublishStatus::accepted);
        }
      });
    }
    for (int i = 0; i < 5; ++i) {
      server().stop();
      EXPECT_TRUE(eventually([&] { return publisher->pending() >= 16 || publisher->pending() == 0; }));
      server().start();
    }
  }
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes_.count(Outcome::confirmed), static_cast<std::size_t>(threads * each));
  ASSERT_TRUE(eventually([&] {
    const auto all = bodies();
    return std::set<std::string>(all.begin(), all.end()).size() == static_cast<std::size_t>(threads * each);
  }));
}

TEST_F(SpoolPublisherTest, TheNextPublisherSendsFirstWhatTheLastOneLeftAndMarksIt) {
  server().stop();
  {
    const auto publisher = this->publisher();
    send(*publisher, 1, 30);
  }
  EXPECT_EQ(outcomes_.count(Outcome::unknown, "spooled"), 30u);
  Outcomes second;
  options_.on_outcome = second.callback();
  const auto subscription = subscribe();
  const auto publisher = this->publisher();
  EXPECT_EQ(publisher->pending(), 30u);
  EXPECT_TRUE(eventually([&] { return publisher->oldest().has_value(); })) << "the broker's publisher has some of them";
  EXPECT_EQ(metric("iotcloud_spool_restored_total"), 30);
  send(*publisher, 31, 40);
  server().start();
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(received_are(40));
  EXPECT_EQ(bodies(), numbered(1, 40));
  const auto all = received();
  for (std::size_t i = 0; i < 40; ++i) EXPECT_EQ(all[i].second, i < 30) << all[i].first;
  EXPECT_EQ(second.count(Outcome::confirmed), 40u);
  for (std::uint64_t i = 1; i <= 10; ++i) EXPECT_EQ(second.of(i).first, Outcome::confirmed);
}

TEST_F(SpoolPublisherTest, AFullSpoolSaysSoAndTellsWhenThereIsRoom) {
  const auto subscription = subscribe();
  spool_.max_bytes = 20'000;
  const auto publisher = this->publisher();
  server().stop();
  int accepted = 0;
  while (publisher->publish(sample(std::string(200, 'x'))) == PublishStatus::accepted) ++accepted;
  EXPECT_GT(accepted, 20);
  EXPECT_EQ(publisher->publish(sample(std::string(200, 'x'))), PublishStatus::would_block);
  EXPECT_EQ(writable_, 0);
  server().start();
  ASSERT_TRUE(eventually([&] { return writable_ == 1; }));
  EXPECT_EQ(publisher->publish(sample("last")), PublishStatus::accepted);
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes_.count(Outcome::confirmed), static_cast<std::size_t>(accepted + 1));
}

TEST_F(SpoolPublisherTest, DropsTheOldestOnlyWhenToldToAndCountsThem) {
  const auto subscription = subscribe();
  spool_.max_bytes = 20'000;
  spool_.when_full = SpoolFull::drop_oldest;
  options_.capacity = 5;
  const auto publisher = this->publisher();
  server().stop();
  send(*publisher, 1, 2000);
  EXPECT_TRUE(eventually([&] { return publisher->pending() < 1000; })) << "drops are reported by another thread";
  server().start();
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(eventually([&] { return !bodies().empty() && bodies().back() == "2000"; }));
  const std::size_t dropped = outcomes_.count(Outcome::dropped, "spool_full");
  EXPECT_EQ(dropped + outcomes_.count(Outcome::confirmed), 2000u);
  EXPECT_EQ(outcomes_.numbers(), 2000u);
  EXPECT_EQ(metric("iotcloud_spool_dropped_total", "spool_full"), static_cast<double>(dropped));
  EXPECT_EQ(bodies().size(), 2000 - dropped);
  std::vector<int> order;
  for (const auto& body : bodies()) order.push_back(std::stoi(body));
  EXPECT_TRUE(std::is_sorted(order.begin(), order.end()));
}

TEST_F(SpoolPublisherTest, AFullDiskIsAsAFullSpool) {
  const auto subscription = subscribe();
  const auto publisher = this->publisher();
  send(*publisher, 1, 3);
  disk_.error = ENOSPC;
  EXPECT_EQ(publisher->publish(sample("x")), PublishStatus::would_block);
  EXPECT_GT(metric("iotcloud_spool_disk_failures_total"), 0);
  disk_.error = 0;
  clock_.advance(std::chrono::seconds(1));
  ASSERT_TRUE(eventually([&] { return writable_ == 1; }));
  send(*publisher, 4, 6);
  ASSERT_TRUE(received_are(6));
  EXPECT_EQ(bodies(), numbered(1, 6));
}

TEST_F(SpoolPublisherTest, AFullDiskDropsWhenTheOldestMayBeDropped) {
  spool_.when_full = SpoolFull::drop_oldest;
  const auto publisher = this->publisher();
  send(*publisher, 1, 3);
  disk_.error = ENOSPC;
  EXPECT_EQ(publisher->publish(sample("4")), PublishStatus::accepted);
  ASSERT_TRUE(eventually([&] { return outcomes_.count(Outcome::dropped, "spool_failed") == 1; }));
  EXPECT_EQ(outcomes_.of(4).second, "spool_failed");
  disk_.error = 0;
}

TEST_F(SpoolPublisherTest, ABrokenDiskCostsNoMessageThatIsOnIt) {
  server().stop();
  spool_.when_full = SpoolFull::drop_oldest;
  spool_.max_bytes = 16'000;
  const auto publisher = this->publisher();
  send(*publisher, 1, 100);
  ASSERT_GT(files(spool_.folder, ".segment").size(), 3U);
  const double before = metric("iotcloud_spool_messages");
  disk_.error = EIO;
  for (int i = 1; i <= 10; ++i) EXPECT_EQ(publisher->publish(sample("x")), PublishStatus::accepted);
  ASSERT_TRUE(eventually([&] { return outcomes_.count(Outcome::dropped, "spool_failed") == 10; }));
  EXPECT_EQ(metric("iotcloud_spool_messages"), before);
  disk_.error = 0;
}

TEST_F(SpoolPublisherTest, AFullDiskThatStaysFullCostsTheOldestFileOnce) {
  server().stop();
  spool_.when_full = SpoolFull::drop_oldest;
  spool_.max_bytes = 16'000;
  const auto publisher = this->publisher();
  send(*publisher, 1, 100);
  const std::size_t before = files(spool_.folder, ".segment").size();
  ASSERT_GT(before, 3U);
  disk_.error = ENOSPC;
  for (int i = 1; i <= 10; ++i) EXPECT_EQ(publisher->publish(sample("x")), PublishStatus::accepted);
  ASSERT_TRUE(eventually([&] { return outcomes_.count(Outcome::dropped, "spool_failed") == 10; }));
  EXPECT_EQ(files(spool_.folder, ".segment").size(), before - 1);
  disk_.error = 0;
}

TEST_F(SpoolPublisherTest, TheDeadlineCountsForWhatWaitsOnDiskToo) {
  options_.deadline = std::chrono::seconds(10);
  options_.capacity = 2;
  {
    server().stop();
    const auto publisher = this->publisher();
    send(*publisher, 1, 5);
    clock_.advance(std::chrono::seconds(6));
    send(*publisher, 6, 8);
  }
  clock_.advance(std::chrono::seconds(6));
  Outcomes second;
  options_.on_outcome = second.callback();
  const auto subscription = subscribe();
  const auto publisher = this->publisher();
  server().start();
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(received_are(3));
  EXPECT_EQ(bodies(), numbered(6, 8));
  EXPECT_EQ(second.count(Outcome::dropped, "deadline"), 5u);
  EXPECT_EQ(metric("iotcloud_spool_dropped_total", "deadline"), 5);
}

TEST_F(SpoolPublisherTest, ATimeOfDayThatIsSetAheadOrBackMovesNoDeadline) {
  options_.deadline = std::chrono::seconds(10);
  options_.capacity = 2;
  constexpr std::int64_t an_hour_ms = 3'600'000;
  const auto subscription = subscribe();
  server().stop();
  const auto publisher = this->publisher();
  send(*publisher, 1, 5);
  clock_.set_wall_ms(clock_.wall_ms() - 2 * an_hour_ms);
  send(*publisher, 6, 8);
  clock_.advance(std::chrono::seconds(6));
  send(*publisher, 9, 10);
  clock_.set_wall_ms(clock_.wall_ms() + 3 * an_hour_ms);
  send(*publisher, 11, 12);
  server().start();
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(received_are(12));
  EXPECT_EQ(bodies(), numbered(1, 12));
  server().stop();
  send(*publisher, 13, 17);
  clock_.set_wall_ms(clock_.wall_ms() - an_hour_ms);
  clock_.advance(std::chrono::seconds(11));
  send(*publisher, 18, 18);
  server().start();
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes_.of(15), (std::pair{Outcome::dropped, std::string("deadline")}));
  EXPECT_EQ(outcomes_.of(18).first, Outcome::confirmed);
}

TEST_F(SpoolPublisherTest, ADamagedMessageIsReportedAndTheRestDelivered) {
  server().stop();
  {
    const auto publisher = this->publisher();
    send(*publisher, 1, 1);
    publisher->publish(sample("second-to-be-damaged"));
    send(*publisher, 3, 4);
  }
  const auto segments = files(spool_.folder, ".segment");
  ASSERT_EQ(segments.size(), 1u);
  std::string bytes = read_all(segments.front());
  bytes[bytes.find("second")] ^= 1;
  write_all(segments.front(), bytes);
  Outcomes second;
  options_.on_outcome = second.callback();
  const auto subscription = subscribe();
  auto publisher = this->publisher();
  server().start();
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(received_are(3));
  EXPECT_THAT(bodies(), ElementsAre("1", "3", "4"));
  EXPECT_EQ(second.count(Outcome::dropped, "spool_damaged"), 1u);
  EXPECT_EQ(metric("iotcloud_spool_dropped_total", "spool_damaged"), 1);
  EXPECT_GT(metric("iotcloud_spool_damaged_bytes_total"), 0);
  send(*publisher, 5, 5);
  ASSERT_TRUE(publisher->drain(patience));
  publisher.reset();
  EXPECT_EQ(files(spool_.folder, ".damaged").size(), 1u) << "kept for a person to look at";
}

TEST_F(SpoolPublisherTest, AMessageThatNoBrokerTakesIsRefusedAndNeverWritten) {
  const auto publisher = this->publisher();
  Message message = sample("x");
  message.properties.set(std::string(300, 'n'), "value");
  const Published refused = publisher->publish(message);
  EXPECT_EQ(refused, PublishStatus::accepted);
  const Published stored = publisher->publish(sample("2"));
  EXPECT_EQ(stored.number, refused.number + 1);
  ASSERT_TRUE(eventually([&] { return outcomes_.numbers() >= 1; }));
  EXPECT_EQ(outcomes_.of(refused.number), std::pair(Outcome::refused, std::string("property_name_too_long")));
  EXPECT_EQ(metric("iotcloud_spool_messages"), 1);
}

TEST_F(SpoolPublisherTest, AMessageLargerThanTheSpoolIsRefused) {
  spool_.max_bytes = 10'000;
  const auto publisher = this->publisher();
  EXPECT_EQ(publisher->publish(sample(std::string(10'000, 'x'))), PublishStatus::accepted);
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes_.of(1).first, Outcome::refused);
}

TEST_F(SpoolPublisherTest, AFolderThatAnotherPublisherHasIsRefused) {
  const auto publisher = this->publisher();
  EXPECT_THROW(this->publisher(), config::Error);
}

TEST_F(SpoolPublisherTest, IntervalPutsTheFilesOnTheDiskNowAndThen) {
  server().stop();
  spool_.interval = std::chrono::minutes(10);
  const auto publisher = this->publisher();
  send(*publisher, 1, 1);
  ASSERT_TRUE(eventually([&] { return clock_.waiting() == 1; })) << "the thread waits by the injected clock";
  const int before = disk_.syncs;
  clock_.advance(spool_.interval);
  ASSERT_TRUE(eventually([&] { return disk_.syncs > before; }));
}

/// What on_stored told last. Thread safe.
class StoredUpTo {
 public:
  auto callback() {
    return [this](std::uint64_t number) {
      EXPECT_GT(number, number_.load()) << "ascending";
      number_ = number;
    };
  }
  std::uint64_t operator()() const { return number_; }

 private:
  std::atomic<std::uint64_t> number_{0};
};

TEST_F(SpoolPublisherTest, PublishWaitsForTheDiskInNoMode) {
  for (const SpoolSync sync : {SpoolSync::never, SpoolSync::interval, SpoolSync::always}) {
    spool_.sync = sync;
    spool_.interval = std::chrono::milliseconds(0);
    spool_.max_bytes = 16 * 4096;  // so that files are made and completed
    const auto subscription = subscribe();
    server().stop();  // what the broker has confirmed needs no sync
    const auto publisher = this->publisher();
    const StandStill still(disk_);
    const int before = disk_.syncs;
    send(*publisher, 1, 1);
    ASSERT_TRUE(eventually([&] { return sync == SpoolSync::never || disk_.syncs > before; }));
    // The thread of the spools stands in sync() now, and will until the end.
    server().start();
    for (int i = 2; i <= 100; ++i) {
      ASSERT_EQ(publisher->publish(sample(std::string(200, 'x'))), PublishStatus::accepted) << i;
    }
    EXPECT_TRUE(publisher->drain(patience)) << "the broker has them, though the disk has not";
  }
}

TEST_F(SpoolPublisherTest, AlwaysTellsWhatALossOfPowerCannotCost) {
  server().stop();
  StoredUpTo stored;
  spool_.sync = SpoolSync::always;
  spool_.on_stored = stored.callback();
  const auto publisher = this->publisher();
  StandStill still(disk_);
  send(*publisher, 1, 3);
  ASSERT_TRUE(eventually([&] { return disk_.syncs > 0; }));
  EXPECT_EQ(stored(), 0u) << "nothing is on the disk yet";
  still.end();
  EXPECT_TRUE(eventually([&] { return stored() == 3; }));
  send(*publisher, 4, 6);
  EXPECT_TRUE(eventually([&] { return stored() == 6; }));
  EXPECT_EQ(publisher->pending(), 6u) << "the broker has none of them";
}

TEST_F(SpoolPublisherTest, WhatTheBrokerHasNeedsNoDisk) {
  const auto subscription = subscribe();
  StoredUpTo stored;
  spool_.sync = SpoolSync::always;
  spool_.on_stored = stored.callback();
  const auto publisher = this->publisher();
  const StandStill still(disk_);
  send(*publisher, 1, 3);
  EXPECT_TRUE(eventually([&] { return stored() == 3; }));
}

TEST_F(SpoolPublisherTest, AlwaysTakesNothingWhileTheDiskFails) {
  server().stop();
  StoredUpTo stored;
  spool_.sync = SpoolSync::always;
  spool_.on_stored = stored.callback();
  const auto publisher = this->publisher();
  send(*publisher, 1, 1);
  ASSERT_TRUE(eventually([&] { return stored() == 1; }));
  disk_.sync_error = EIO;
  send(*publisher, 2, 2);
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spool_disk_failures_total") > 0; }));
  EXPECT_EQ(publisher->publish(sample("3")), PublishStatus::would_block);
  disk_.sync_error = 0;
  clock_.advance(std::chrono::seconds(1));
  ASSERT_TRUE(eventually([&] { return writable_ > 0; }));
  const int before = disk_.syncs;
  send(*publisher, 3, 3);
  ASSERT_TRUE(eventually([&] { return disk_.syncs > before; }));
  EXPECT_EQ(stored(), 1u) << "a sync that succeeds says nothing of what an earlier one failed for";
  server().start();
  const auto subscription = subscribe();
  EXPECT_TRUE(eventually([&] { return stored() == 3; }));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes_.count(Outcome::confirmed), 3u);
}

TEST_F(SpoolPublisherTest, MayBeClosedByItsOwnCallback) {
  const auto subscription = subscribe();
  std::unique_ptr<Publisher> publisher;
  std::promise<void> closed;
  options_.on_outcome = [&](std::uint64_t, Outcome, const std::string&) {
    publisher.reset();
    closed.set_value();
  };
  publisher = this->publisher();
  Publisher* const raw = publisher.get();
  server().stop();
  ASSERT_EQ(raw->publish(sample("1")), PublishStatus::accepted);
  server().start();
  ASSERT_EQ(closed.get_future().wait_for(patience), std::future_status::ready);
  ASSERT_TRUE(eventually([&] { return !std::filesystem::exists(spool_.folder); }));
}

}  // namespace
}  // namespace iotcloud::brokers::spool
