// The client's behaviour when the server's answers are late or never come.
#include <algorithm>
#include <chrono>
#include <future>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/brokers/rabbitmq/frame_proxy.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

class RabbitMqAnswers : public testing::Test {
 protected:
  static void SetUpTestSuite() { server_ = new tests::PrivateServer("rabbitmq.py"); }
  static void TearDownTestSuite() { delete std::exchange(server_, nullptr); }
  std::unique_ptr<Broker> broker() const {
    BrokerOptions options;
    options.urls = {proxy_.url()};
    options.properties = {{"confirm_timeout_ms", "1000"}};
    options.rpc_timeout = patience;
    options.heartbeat = std::chrono::minutes(1);  // neither side gives the other up while the proxy holds frames back
    return make_broker(options);
  }
  static Topic topic(const std::string& name) { return {"answers", "gw.driver." + name, true}; }

  static tests::PrivateServer* server_;
  FrameProxy proxy_{server_->url()};
};

tests::PrivateServer* RabbitMqAnswers::server_ = nullptr;

TEST_F(RabbitMqAnswers, MessagesThatAreNeverConfirmedAreSentAgainMarkedOnAnotherConnection) {
  const auto broker = this->broker();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic("lost"), {}, inbox.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }));
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic("lost"), options);
  const auto publish = [&](int from, int to) {
    for (int i = from; i <= to; ++i) publisher->publish(text_message(std::to_string(i)));
  };
  publish(1, 5);
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(inbox.wait_for(5));
  const int connections = proxy_.connections();
  proxy_.swallow_confirmations(true);
  publish(6, 10);
  ASSERT_TRUE(inbox.wait_for(10)) << "the server has them";
  ASSERT_TRUE(eventually([&] { return proxy_.connections() > connections; }));
  proxy_.swallow_confirmations(false);
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(inbox.wait_for(15)) << "those five were sent again";
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 10U);
  EXPECT_TRUE(outcomes.each_once());
  std::set<std::string> seen;
  std::vector<std::string> firsts;
  for (const auto& received : inbox.all()) {
    if (seen.insert(received.body).second) {
      firsts.push_back(received.body);
    } else {
      EXPECT_TRUE(received.redelivered) << "a second " << received.body << " that is not marked";
    }
  }
  EXPECT_EQ(firsts, numbered(1, 10));
}

TEST_F(RabbitMqAnswers, CopiesThatTheServerTakesLateFromALostConnectionAreMarked) {
  const auto broker = this->broker();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic("late"), {}, inbox.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }));
  const auto publisher = broker->publisher(topic("late"), {});
  const auto publish = [&](int from, int to) {
    for (int i = from; i <= to; ++i) publisher->publish(text_message(std::to_string(i)));
    ASSERT_TRUE(publisher->drain(patience));
  };
  publish(1, 5);
  ASSERT_TRUE(inbox.wait_for_last("5"));
  const std::size_t before = inbox.size();
  proxy_.withhold_messages();
  publish(6, 10);
  ASSERT_TRUE(inbox.wait_for(before + 5)) << "through another connection";
  proxy_.release_messages();
  ASSERT_TRUE(inbox.wait_for(before + 10)) << "again, from the lost one";
  publish(11, 12);
  ASSERT_TRUE(inbox.wait_for_last("12"));
  EXPECT_EQ(firsts(inbox), numbered(1, 12));
  // One connection to read, one to publish, and one that replaced it; more when the server was so slow that others were
  // replaced, too.
  const bool others_too = proxy_.connections() > 3;
  for (const auto& received : inbox.all()) {
    const int number = std::stoi(received.body);
    if (number >= 6 && number <= 10) {
      EXPECT_TRUE(received.redelivered) << received.body;
    } else if (!others_too) {
      EXPECT_FALSE(received.redelivered) << received.body;
    }
  }
}

TEST_F(RabbitMqAnswers, AConnectionWithNothingUnderWayIsNotMadeAnew) {
  const auto broker = this->broker();
  PublisherOptions options;
  options.own_queue = true;
  const auto publisher = broker->publisher(topic("quiet"), options);
  publisher->publish(text_message("1"));
  ASSERT_TRUE(publisher->drain(patience));
  const int connections = proxy_.connections();
  EXPECT_FALSE(eventually([&] { return proxy_.connections() > connections; }, std::chrono::milliseconds(2500)));
}

TEST_F(RabbitMqAnswers, TheChannelOfASubscriptionThatEndedIsUsedAgain) {
  constexpr int rounds = 20;
  const auto broker = this->broker();
  for (int i = 0; i < rounds; ++i) {
    Inbox inbox;
    auto subscription = broker->subscribe(topic("again"), {}, inbox.handler());
    ASSERT_TRUE(eventually([&] { return subscription->active(); }));
    subscription.reset();
    // A server may confirm an end after it opened the next channels.
    ASSERT_TRUE(eventually([&] { return proxy_.seen(AMQP_CHANNEL_CLOSE_OK_METHOD) == i + 1; }));
  }
  EXPECT_LE(proxy_.highest_channel(), 2) << "one, while the confirmed end of the one before is still being read";
}

/// Acknowledgements and rejections by turns are as many frames: more than fit between here and the proxy.
TEST_F(RabbitMqAnswers, WhoSettlesOrEndsASubscriptionDoesNotWaitForAServerThatTakesNothing) {
  constexpr std::size_t messages = 20'000;
  FrameProxy proxy(server_->url(), FrameProxy::Buffers::small);
  BrokerOptions options;
  options.urls = {proxy.url()};
  options.heartbeat = std::chrono::minutes(1);  // neither side gives the other up
  const auto broker = make_broker(options);
  Holder holder;
  SubscriptionOptions reading;
  reading.prefetch = messages;
  auto subscription = broker->subscribe(topic("full"), reading, holder.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }));
  {
    BrokerOptions direct;
    direct.urls = {server_->url()};
    const auto other = make_broker(direct);
    PublisherOptions sending;
    sending.capacity = messages;
    const auto publisher = other->publisher(topic("full"), sending);
    for (std::size_t i = 0; i < messages; ++i) {
      ASSERT_EQ(publisher->publish(text_message("x")), PublishStatus::accepted);
    }
    ASSERT_TRUE(holder.wait_for(messages));
  }
  proxy.stop_taking();
  const auto told = [&] { return proxy.seen(AMQP_BASIC_ACK_METHOD) + proxy.seen(AMQP_BASIC_NACK_METHOD); };
  auto settling = std::async(std::launch::async, [&] {
    for (std::size_t i = 0; i < messages; ++i) {
      holder.settle(i, i % 2 == 0 ? Settlement::accept : Settlement::reject);
    }
    subscription.reset();
  });
  EXPECT_EQ(settling.wait_for(patience), std::future_status::ready);
  EXPECT_LT(told(), static_cast<int>(messages)) << "the buffers took all: this test looks at nothing";
  proxy.take_again();
  settling.get();
  EXPECT_TRUE(eventually([&] { return proxy.seen(AMQP_CHANNEL_CLOSE_METHOD) == 1; }));
  EXPECT_EQ(told(), static_cast<int>(messages)) << "all that was settled, before the channel was closed";
}

TEST_F(RabbitMqAnswers, TheServerIsAskedForSixtyFourSubscriptionsAtOnceAtMost) {
  constexpr int at_once = 64;
  constexpr int all = 150;
  const auto broker = this->broker();
  Inbox first;
  std::vector<std::unique_ptr<Inbox>> inboxes;
  std::vector<std::unique_ptr<Subscription>> subscriptions;
  subscriptions.push_back(broker->subscribe(topic("window.0"), {}, first.handler()));
  ASSERT_TRUE(eventually([&] { return subscriptions.front()->active(); }));
  ASSERT_EQ(proxy_.seen(AMQP_BASIC_CONSUME_METHOD), 1);
  proxy_.hold_answers();
  for (int i = 1; i <= all; ++i) {
    inboxes.push_back(std::make_unique<Inbox>());
    subscriptions.push_back(broker->subscribe(topic("window." + std::to_string(i)), {}, inboxes.back()->handler()));
  }
  EXPECT_TRUE(eventually([&] { return proxy_.seen(AMQP_BASIC_CONSUME_METHOD) == 1 + at_once; }));
  EXPECT_FALSE(eventually([&] { return proxy_.seen(AMQP_BASIC_CONSUME_METHOD) > 1 + at_once; }, moment))
      << "the others wait until it has answered";
  proxy_.release_answers();
  for (const auto& subscription : subscriptions) EXPECT_TRUE(eventually([&] { return subscription->active(); }));
  EXPECT_EQ(proxy_.seen(AMQP_BASIC_CONSUME_METHOD), 1 + all) << "each was asked for once";
}

}  // namespace
}  // namespace iotcloud::brokers
