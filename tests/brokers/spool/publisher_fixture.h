#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/spool/spool_fixture.h"
#include "iotcloud/tests/config/hand_clock.h"
#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/brokers/spool/spooled_publisher.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::brokers::spool {

using tests::patience;

/// Collects outcomes by publish number; number 0 may have several. Thread safe.
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
  /// The only outcome of a message.
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

/// A publisher with a spool to an embedded broker, with a clock, a disk and metrics of its own.
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
  /// Reads with manual acknowledgement, so that no message is lost with the server.
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
    return tests::eventually([&] { return bodies().size() >= count; }, patience);
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

  tests::TemporaryFolder folder_;
  TestDisk disk_;
  tests::HandClock clock_;
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

}  // namespace iotcloud::brokers::spool
