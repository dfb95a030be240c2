// A RabbitMQ cluster of three nodes with quorum queues loses one node.
#include <algorithm>
#include <fstream>
#include <memory>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include <fmt/core.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

class RabbitMqCluster : public testing::Test {
 protected:
  static void SetUpTestSuite() { cluster_ = new tests::PrivateServer("rabbitmq_cluster.py"); }
  static void TearDownTestSuite() { delete std::exchange(cluster_, nullptr); }
  static std::unique_ptr<Broker> broker() {
    BrokerOptions options;
    options.urls = cluster_->urls();
    options.properties = {{"queue_type", "quorum"}};
    options.heartbeat = std::chrono::seconds(2);
    return make_broker(options);
  }
  static Topic topic() {
    return {"cluster", std::string("gw.driver.") + testing::UnitTest::GetInstance()->current_test_info()->name(), true};
  }

  static tests::PrivateServer* cluster_;
};

tests::PrivateServer* RabbitMqCluster::cluster_ = nullptr;

/// Open connections from this network namespace to the server's port; only this test has any.
int connections_to(const std::string& url) {
  std::ifstream table("/proc/self/net/tcp");
  std::string line;
  int found = 0;
  const std::string port = fmt::format(":{:04X}", parse_broker_url(url).port);
  while (std::getline(table, line)) {
    std::istringstream words(line);
    std::string number;
    std::string local;
    std::string remote;
    std::string state;
    words >> number >> local >> remote >> state;
    if (remote.ends_with(port) && state == "01") ++found;  // established
  }
  return found;
}

/// First deliveries are in order; later copies are marked.
void expect_whole(const Inbox& inbox, int last) {
  std::set<int> seen;
  std::vector<int> firsts;
  for (const auto& received : inbox.all()) {
    const int number = std::stoi(received.body);
    if (seen.insert(number).second) {
      firsts.push_back(number);
    } else {
      EXPECT_TRUE(received.redelivered) << "a second " << number << " that is not marked";
    }
  }
  EXPECT_EQ(firsts.size(), static_cast<std::size_t>(last));
  EXPECT_TRUE(std::is_sorted(firsts.begin(), firsts.end()));
}

TEST_F(RabbitMqCluster, AnotherNodeStandsInAndThePreferredOneIsTakenAgainWithoutLoss) {
  const auto broker = this->broker();
  Inbox inbox;
  SubscriptionOptions reading;
  reading.group = "readers";
  const auto subscription = broker->subscribe(topic(), reading, inbox.handler());
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic(), options);
  int last = 0;
  const auto publish = [&](int count) {
    for (int i = 0; i < count; ++i) {
      ASSERT_EQ(publisher->publish(text_message(std::to_string(++last))), PublishStatus::accepted);
    }
  };
  const auto all_there = [&] {
    return inbox.wait_until(
        [&](const auto& received) { return !received.empty() && received.back().body == std::to_string(last); });
  };
  publish(100);
  ASSERT_TRUE(all_there());
  cluster_->kill(1);
  publish(100);
  EXPECT_TRUE(all_there()) << "on another node";
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(connections_to(cluster_->urls().front()), 0);
  cluster_->start(1);
  EXPECT_TRUE(eventually([&] {
    publish(1);
    return publisher->drain(patience) && connections_to(cluster_->urls().front()) >= 2;
  })) << "the publishing connection and the consuming one are back";
  publish(100);
  EXPECT_TRUE(all_there());
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), static_cast<std::size_t>(last));
  expect_whole(inbox, last);
}

}  // namespace
}  // namespace iotcloud::brokers
