// A publisher with a spool: nothing that it accepted is lost, whatever becomes of broker, disk and process.
#include <algorithm>
#include <atomic>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/spool/spool_fixture.h"
#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/brokers/spool/spooled_publisher.h>
#include <iotcloud/config/error.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::brokers::spool {
namespace {

using testing::Each;
using testing::ElementsAre;
using testing::IsEmpty;
using tests::eventually;

constexpr std::chrono::seconds patience{60};

class TestClock final : public config::Clock {
 public:
  Instant now() const override { return Instant(std::chrono::milliseconds(ms_)); }
  std::int64_t wall_ms() const override { return 1'000'000 + ms_; }
  void advance(std::chrono::milliseconds by) { ms_ += by.count(); }

 private:
  std::atomic<std::int64_t> ms_{1'000'000};
};

/// Outcomes by number; 0 may have many.
class Outcomes {
 public:
  auto callback() {
    return [this](std::uint64_t number, Outcome outcome, const std::string& reason) {
      const std::lock_guard lock(mutex_);
      all_[number].emplace_back(outcome, reason);
    };
  }
  std::size_t count(Outcome outcome, const std::string& reason = "") const {
    const std::lock_guard lock(mutex_);
    std::size_t sum = 0;
    for (const auto& [number, some] : all_) {
      for (const auto& one : some) sum += one == std::pair(outcome, reason) ? 1 : 0;
    }
    return sum;
  }
  /// The only one of a message.
  std::pair<Outcome, std::string> of(std::uint64_t number) const {
    const std::lock_guard lock(mutex_);
    const auto found = all_.find(number);
    if (found == all_.end() || found->second.size() != 1) {
      ADD_FAILURE() << "message " << number << " has not one outcome";
      return {Outcome::unknown, "?"};
    }
    return found->second.front();
  }
  std::size_t numbers() const {
    const std::lock_guard lock(mutex_);
    return all_.size();
  }

 private:
  mutable std::mutex mutex_;
  std::map<std::uint64_t, std::vector<std::pair<Outcome, std::string>>> all_;
};

class SpoolPublisherTest : public testing::Test {
 protected:
  using Received = std::pair<std::string, bool>;

  SpoolPublisherTest() {
    spool_.folder = folder_ / "spool";
    spool_.metrics = &metrics_;
    spool_.disk = &disk_;
    spool_.clock = &clock_;
    options_.on_outcome = outcomes_.callback();
    options_.on_writable = [this] { ++writable_; };
    BrokerOptions broker;
    broker.urls = {"embedded://" + std::string(testing::UnitTest::GetInstance()->current_test_info()->name())};
    broker.metrics = &metrics_;
    broker.clock = &clock_;
    broker_ = make_broker(broker);
  }
  ~SpoolPublisherTest() override { server().start(); }

  embedded::Server server() {
    return embedded::Server::named(testing::UnitTest::GetInstance()->current_test_info()->name());
  }
  std::unique_ptr<Publisher> publisher() { return make_spooled_publisher(*broker_, topic_, options_, spool_); }
  /// Reads with manual acknowledgement, so that nothing is lost with the server.
  std::unique_ptr<Subscription> subscribe() {
    SubscriptionOptions options;
    options.group = "readers";
    return broker_->subscribe(topic_, options, [this](Delivery delivery) {
      {
        const std::lock_guard lock(mutex_);
        received_.emplace_back(std::string(delivery.message.payload.text()), delivery.redelivered);
      }
      delivery.settle(Settlement::accept);
    });
  }
  std::vector<std::string> bodies() const {
    const std::lock_guard lock(mutex_);
    std::vector<std::string> all;
    for (const auto& [body, redelivered] : received_) all.push_back(body);
    return all;
  }
  std::vector<Received> received() const {
    const std::lock_guard lock(mutex_);
    return received_;
  }
  bool received_are(std::size_t count) {
    return eventually([&] { return bodies().size() >= count; }, patience);
  }
  static std::vector<std::string> numbered(int from, int to) {
    std::vector<std::string> all;
    for (int i = from; i <= to; ++i) all.push_back(std::to_string(i));
    return all;
  }
  static void send(Publisher& publisher, int from, int to) {
    for (int i = from; i <= to; ++i) {
      ASSERT_EQ(publisher.publish(sample(std::to_string(i))), PublishStatus::accepted) << i;
    }
  }
  double metric(const std::string& name, const std::string& reason = "") const {
    double sum = 0;
    for (const auto& sample : metrics_.collect()) {
      const auto label = sample.labels.find("reason");
      if (sample.name == name && (reason.empty() || (label != sample.labels.end() && label->second == reason))) {
        sum += sample.value;
      }
    }
    return sum;
  }

  TemporaryFolder folder_;
  TestDisk disk_;
  TestClock clock_;
  config::Metrics metrics_;
  Topic topic_{"exchange", "spool.test", true};
  PublisherOptions options_;
  SpoolOptions spool_;
  Outcomes outcomes_;
  std::atomic<int> writable_{0};
  mutable std::mutex mutex_;
  std::vector<Received> received_;  ///< guarded by mutex_
  std::unique_ptr<Broker> broker_;
};

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
