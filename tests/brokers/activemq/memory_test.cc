// A server whose memory is full: with and without its own flow control.
#include <algorithm>
#include <array>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/captured_log.h"
#include "iotcloud/tests/servers/private_server.h"
#include <iotcloud/config/metrics.h>

namespace iotcloud::brokers {
namespace {

/// Keeps more messages under way on a few topics than the server's memory holds.
class FullServer {
 public:
  explicit FullServer(const std::vector<std::string>& arguments) : server_("activemq.py", arguments) {
    BrokerOptions options;
    options.urls = {server_.url()};
    options.metrics = &metrics_;
    broker_ = make_broker(options);
    for (std::size_t i = 0; i < numbers_.size(); ++i) {
      const Topic topic{"", "gw.driver.full." + std::to_string(i), false};
      subscriptions_.push_back(broker_->subscribe(topic, {}, [this, i](Delivery delivery) {
        const std::lock_guard lock(mutex_);
        numbers_[i].push_back(std::stoi(std::string(delivery.message.payload.text())));
        ++arrived_;
        changed_.notify_all();
        delivery.settle(Settlement::accept);
      }));
      publishers_.push_back(broker_->publisher(topic, {}));
    }
  }

  /// Sends to each topic.
  void send(int count) {
    for (const auto& subscription : subscriptions_) ASSERT_TRUE(eventually([&] { return subscription->active(); }));
    for (int i = 0; i < count; ++i) {
      ++sent_;
      std::string body = std::to_string(sent_);
      body.resize(200'000, ' ');
      for (const auto& publisher : publishers_) {
        ASSERT_EQ(publisher->publish(text_message(body)), PublishStatus::accepted);
      }
      ASSERT_TRUE(wait_until_under_way(most_under_way));
    }
    ASSERT_TRUE(wait_until_under_way(0));
  }
  /// Whether the messages of each topic arrived in the order in which they were sent.
  bool in_order() const {
    const std::lock_guard lock(mutex_);
    return std::all_of(numbers_.begin(), numbers_.end(),
                       [](const auto& numbers) { return std::is_sorted(numbers.begin(), numbers.end()); });
  }
  std::uint64_t overtook() {
    return metrics_.counter("iotcloud_broker_overtook_total", "", {{"broker", "activemq"}}).value();
  }

 private:
  static constexpr std::size_t most_under_way = 200;  ///< 40 MB

  bool wait_until_under_way(std::size_t most) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, patience, [&] { return sent_ * publishers_.size() - arrived_ <= most; });
  }

  tests::PrivateServer server_;
  config::Metrics metrics_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  // Guarded by mutex_:
  std::array<std::vector<int>, 4> numbers_;
  std::size_t arrived_ = 0;
  // Used only by the sending thread.
  std::size_t sent_ = 0;
  std::unique_ptr<Broker> broker_;
  std::vector<std::unique_ptr<Subscription>> subscriptions_;
  std::vector<std::unique_ptr<Publisher>> publishers_;
};

TEST(ActiveMqMemory, ThatIsFullChangesNoOrder) {
  FullServer server({"--memory-mb", "8"});
  ASSERT_NO_FATAL_FAILURE(server.send(200));
  EXPECT_TRUE(server.in_order());
}

TEST(ActiveMqMemory, ThatIsFullChangesTheOrderUnderTheServersOwnFlowControlAndThatIsCounted) {
  FullServer server({"--memory-mb", "8", "--flow-control"});
  // One change may go uncounted: the server stores and confirms on two threads, and may store 2, 1 and confirm 1, 2.
  for (int i = 0; i < 100 && (server.in_order() || server.overtook() == 0); ++i) {
    ASSERT_NO_FATAL_FAILURE(server.send(100));
  }
  EXPECT_FALSE(server.in_order());
  EXPECT_GT(server.overtook(), 0U);
}

TEST(ActiveMqMemory, OnDiskThatIsFullLosesNothingWhileTheServerRefusesMessages) {
  constexpr int count = 100;
  const tests::PrivateServer server("activemq.py", {"--store-mb", "8"});
  BrokerOptions options;
  options.urls = {server.url()};
  const auto broker = make_broker(options);
  const Topic topic{"", "gw.driver.refusing", true};
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }));
  subscription->pause();
  Outcomes outcomes;
  PublisherOptions publishing;
  publishing.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, publishing);
  {
    const tests::CapturedLog log;
    for (int i = 0; i < count; ++i) {
      ASSERT_EQ(publisher->publish(text_message(std::string(200'000, 'x'))), PublishStatus::accepted);
    }
    ASSERT_TRUE(eventually([&] { return log.contains("refuses messages for topic " + topic.name); }));
  }
  EXPECT_FALSE(publisher->drain(moment)) << "the disk was never full";
  subscription->resume();
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), static_cast<std::size_t>(count));
  EXPECT_TRUE(inbox.wait_for(count));
}

}  // namespace
}  // namespace iotcloud::brokers
