// A publisher with a spool: nothing that it accepted is lost, whatever becomes of broker, disk and process.
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
  EXPECT_EQ(publisher->publish(message), PublishStatus::accepted);
  send(*publisher, 2, 2);
  ASSERT_TRUE(eventually([&] { return outcomes_.numbers() >= 1; }));
  EXPECT_EQ(outcomes_.of(1), std::pair(Outcome::refused, std::string("property_name_too_long")));
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
  spool_.interval = std::chrono::milliseconds(1);
  const auto publisher = this->publisher();
  send(*publisher, 1, 1);
  const int before = disk_.syncs;
  ASSERT_TRUE(eventually([&] { return disk_.syncs > before || before > 1; }));
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
