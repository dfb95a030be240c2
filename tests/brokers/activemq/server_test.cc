// Behaviour that needs a real ActiveMQ server: foreign programs on its queues, hanging, fail-over.
#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <proton/connection_options.hpp>
#include <proton/container.hpp>
#include <proton/message.hpp>
#include <proton/messaging_handler.hpp>
#include <proton/sender.hpp>
#include <proton/tracker.hpp>
#include <proton/types.hpp>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

class ActiveMqServer : public testing::Test {
 protected:
  static void SetUpTestSuite() { server_ = std::make_unique<tests::PrivateServer>("activemq.py"); }
  static void TearDownTestSuite() { server_.reset(); }

  static std::unique_ptr<Broker> broker(std::vector<std::string> urls = {server_->url()}) {
    BrokerOptions options;
    options.urls = std::move(urls);
    options.rpc_timeout = patience;
    return make_broker(options);
  }
  static Topic topic(bool durable = false) {
    const std::string test = testing::UnitTest::GetInstance()->current_test_info()->name();
    return {"", "gw.driver." + test, durable};
  }
  /// Publishes one more message once the last one has its outcome, however long that takes: publishers have limits.
  static void publish_next(Publisher& publisher, int& sent) {
    if (publisher.pending() > 0) return;
    ++sent;
    publish_numbers(publisher, sent, sent);
  }

  static std::unique_ptr<tests::PrivateServer> server_;
};

std::unique_ptr<tests::PrivateServer> ActiveMqServer::server_;

/// A foreign program that sends messages to a queue.
class ForeignSender final : public proton::messaging_handler {
 public:
  ForeignSender(std::string url, std::string queue, std::vector<proton::message> messages)
      : url_(std::move(url)), queue_(std::move(queue)), messages_(std::move(messages)) {}
  void send() { proton::container(*this).run(); }

 private:
  void on_container_start(proton::container& container) override {
    proton::connection_options options;
    options.sasl_allowed_mechs("ANONYMOUS");
    container.connect("amqp" + url_.substr(url_.find("://")), options)
        .
        operator proton::connection()
        .open_sender("queue://" + queue_);
  }
  void on_sendable(proton::sender& sender) override {
    for (; sent_ < messages_.size() && sender.credit() > 0; ++sent_) sender.send(messages_[sent_]);
  }
  void on_tracker_settle(proton::tracker& tracker) override {
    if (++answered_ == messages_.size()) tracker.connection().close();
  }

  const std::string url_;
  const std::string queue_;
  const std::vector<proton::message> messages_;
  std::size_t sent_ = 0;
  std::size_t answered_ = 0;
};

TEST_F(ActiveMqServer, TakesMessagesOfForeignProgramsWithOddProperties) {
  const auto broker = this->broker();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }));
  proton::message text;
  text.body() = std::string("a text message");
  text.properties().put("sensorID", "java");
  text.properties().put("time", std::int64_t{77});
  text.properties().put("flag", false);
  text.properties().put("ratio", 0.25);
  proton::message bytes;
  bytes.inferred(true);
  bytes.body() = proton::binary("bytes");
  proton::message map;
  map.body() = std::map<std::string, proton::scalar>{{"k", 1}};
  proton::message last;
  last.body() = std::string("last");
  ForeignSender(server_->url(), topic().name, {text, bytes, map, proton::message(), last}).send();
  ASSERT_TRUE(inbox.wait_for(4));
  EXPECT_THAT(inbox.bodies(), testing::ElementsAre("a text message", "bytes", "", "last"));
  const Message first = inbox.all().front().message;
  EXPECT_EQ(first.driver_id, "java");
  EXPECT_EQ(first.time_ms, 77);
  EXPECT_EQ(*first.properties.find("flag"), "false");
  EXPECT_EQ(*first.properties.find("ratio"), "0.25");
}

TEST_F(ActiveMqServer, AReaderOfTheTopicsOwnQueueThatComesLaterGetsWhatIsSentFromThenOn) {
  const auto broker = this->broker();
  Inbox of_group;
  SubscriptionOptions group;
  group.group = "a topology.1";
  const auto first = broker->subscribe(topic(), group, of_group.handler());
  const auto publisher = broker->publisher(topic(), {});
  publish_numbers(*publisher, 1, 10);
  ASSERT_TRUE(of_group.wait_for(10));
  Inbox own;
  const auto second = broker->subscribe(topic(), {}, own.handler());
  ASSERT_TRUE(eventually([&] { return second->active(); }));
  // The server reports the new queue to the publisher among all its other messages.
  int sent = 10;
  ASSERT_TRUE(eventually([&] {
    publish_next(*publisher, sent);
    return own.size() > 0;
  }));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_TRUE(of_group.wait_for(static_cast<std::size_t>(sent)));
  EXPECT_EQ(of_group.bodies(), numbered(1, sent));
}

TEST_F(ActiveMqServer, AServerThatHangsIsNoticedAndNothingIsLost) {
  BrokerOptions options;
  options.urls = {server_->url()};
  options.heartbeat = std::chrono::seconds(1);
  const auto broker = make_broker(options);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(true), {}, inbox.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }));
  const auto publisher = broker->publisher(topic(true), {});
  publish_numbers(*publisher, 1, 10);
  ASSERT_TRUE(inbox.wait_for(10));
  server_->pause();
  publish_numbers(*publisher, 11, 50);
  for (int i = 0; i < 20; ++i) publisher->publish(text_message(std::string(2'000'000, 'x')));
  EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::connecting && !subscription->active(); }));
  server_->resume();
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(inbox.wait_until([](const auto& received) {
    return std::count_if(received.begin(), received.end(), [](const auto& one) { return one.body.size() > 100; }) >= 20;
  }));
  std::vector<std::string> firsts;
  for (const std::string& body : inbox.bodies()) {
    if (body.size() < 100 && std::find(firsts.begin(), firsts.end(), body) == firsts.end()) firsts.push_back(body);
  }
  EXPECT_EQ(firsts, numbered(1, 50));
}

TEST_F(ActiveMqServer, AStandbyServerIsUsedUntilThePreferredOneIsBack) {
  tests::PrivateServer preferred("activemq.py");
  const auto both = broker({preferred.url(), server_->url()});
  const auto at_standby = broker({server_->url()});
  const auto at_preferred = broker({preferred.url()});
  Inbox standby_inbox;
  Inbox preferred_inbox;
  const auto standby_reader = at_standby->subscribe(topic(), {}, standby_inbox.handler());
  const auto preferred_reader = at_preferred->subscribe(topic(), {}, preferred_inbox.handler());
  const auto publisher = both->publisher(topic(), {});
  publish_numbers(*publisher, 1, 3);
  ASSERT_TRUE(preferred_inbox.wait_for(3));
  ASSERT_TRUE(publisher->drain(patience));
  preferred.kill();
  publish_numbers(*publisher, 4, 6);  // what goes into the dead connection is sent again
  ASSERT_TRUE(standby_inbox.wait_for(3));
  EXPECT_THAT(standby_inbox.bodies(), testing::ElementsAre("4", "5", "6"));
  preferred.start();
  ASSERT_TRUE(eventually([&] { return preferred_reader->active(); }));
  int sent = 6;
  ASSERT_TRUE(eventually([&] {
    publish_next(*publisher, sent);
    return preferred_inbox.size() > 3;
  }));
  EXPECT_TRUE(publisher->drain(patience));
}

TEST_F(ActiveMqServer, UrgentMessagesHaveConnectionsOfTheirOwn) {
  const auto broker = this->broker();
  Inbox inbox;
  SubscriptionOptions reading;
  reading.priority = urgent_priority;
  const auto subscription = broker->subscribe(topic(), reading, inbox.handler());
  PublisherOptions sending;
  sending.priority = urgent_priority;
  const auto publisher = broker->publisher(topic(), sending);
  publish_numbers(*publisher, 1, 20);
  ASSERT_TRUE(inbox.wait_for(20));
  EXPECT_EQ(inbox.bodies(), numbered(1, 20));
}

TEST_F(ActiveMqServer, OneBrokerObjectHoldsAThousandSubscriptionsAndPublishers) {
  const auto broker = this->broker();
  Inbox inbox;  // outlives those that call it, also when not all messages come
  std::vector<std::unique_ptr<Subscription>> subscriptions;
  std::vector<std::unique_ptr<Publisher>> publishers;
  for (int i = 0; i < 1000; ++i) {
    Topic one = topic();
    one.name += "." + std::to_string(i);
    subscriptions.push_back(broker->subscribe(one, {}, inbox.handler()));
    publishers.push_back(broker->publisher(one, {}));
    ASSERT_EQ(publishers.back()->publish(text_message(std::to_string(i))), PublishStatus::accepted);
  }
  EXPECT_TRUE(inbox.wait_for(1000));
}

TEST_F(ActiveMqServer, SubscriptionsThatEndBeforeTheServerAnswersHarmNoOther) {
  const auto broker = this->broker();
  const auto publisher = broker->publisher(topic(), {});
  for (int round = 1; round <= 200; ++round) {
    for (int i = 0; i < 5; ++i) broker->subscribe(topic(), {}, [](Delivery) {});
    Inbox inbox;
    const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
    publish_numbers(*publisher, round, round);
    ASSERT_TRUE(inbox.wait_for_last(std::to_string(round)));
  }
}

TEST_F(ActiveMqServer, AnUnknownPropertyIsAnErrorThatNamesIt) {
  BrokerOptions options;
  options.urls = {server_->url()};
  options.properties = {{"colour", "blue"}};
  try {
    make_broker(options);
    FAIL();
  } catch (const std::exception& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("colour"));
  }
}

}  // namespace
}  // namespace iotcloud::brokers
