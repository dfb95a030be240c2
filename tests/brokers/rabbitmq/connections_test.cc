// The connections of one broker object: urgent channels have their own, and many subscriptions need several.
#include <atomic>
#include <cstddef>
#include <future>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers {
namespace {

constexpr int channels = 16;

class RabbitMqConnections : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    server_ = new tests::PrivateServer("rabbitmq.py", {"--channel-max", std::to_string(channels)});
  }
  static void TearDownTestSuite() { delete std::exchange(server_, nullptr); }
  static std::unique_ptr<Broker> broker(const std::map<std::string, std::string>& properties = {}) {
    BrokerOptions options;
    options.urls = {server_->url()};
    options.properties = properties;
    return make_broker(options);
  }
  static Topic topic(const std::string& name) { return {"connections", "gw.driver." + name, false}; }

  static tests::PrivateServer* server_;
};

tests::PrivateServer* RabbitMqConnections::server_ = nullptr;

/// Subscribes to `count` topics and sends each a message.
void read_many(Broker& broker, const std::string& prefix, int count) {
  std::vector<std::unique_ptr<Inbox>> inboxes;
  std::vector<std::unique_ptr<Subscription>> subscriptions;
  for (int i = 0; i < count; ++i) {
    inboxes.push_back(std::make_unique<Inbox>());
    subscriptions.push_back(
        broker.subscribe({"connections", prefix + std::to_string(i), false}, {}, inboxes.back()->handler()));
  }
  for (const auto& subscription : subscriptions) ASSERT_TRUE(eventually([&] { return subscription->active(); }));
  for (int i = 0; i < count; ++i) {
    const auto publisher = broker.publisher({"connections", prefix + std::to_string(i), false}, {});
    publisher->publish(text_message(std::to_string(i)));
    ASSERT_TRUE(publisher->drain(patience));
  }
  for (int i = 0; i < count; ++i) {
    ASSERT_TRUE(inboxes[static_cast<std::size_t>(i)]->wait_for(1));
    EXPECT_THAT(inboxes[static_cast<std::size_t>(i)]->bodies(), testing::ElementsAre(std::to_string(i)));
  }
}

TEST_F(RabbitMqConnections, ASecondOneTakesTheSubscriptionsForWhichTheServerHasNoChannelLeft) {
  read_many(*broker(), "more.", 3 * channels);
}

TEST_F(RabbitMqConnections, ASecondOneIsMadeBeforeTheFirstIsFull) {
  read_many(*broker({{"channels_per_connection", "8"}}), "asked.", 20);
}

TEST_F(RabbitMqConnections, ASubscriptionThatEndsLeavesItsChannelToAnother) {
  const auto broker = this->broker();
  for (int round = 0; round < 3; ++round) read_many(*broker, "again.", channels);
}

TEST_F(RabbitMqConnections, AControlMessageDoesNotWaitBehindBulkData) {
  constexpr int bulk_messages = 200;
  const auto broker = this->broker();
  Holder bulk;
  SubscriptionOptions all;
  all.prefetch = 300;
  const auto bulk_reader = broker->subscribe(topic("bulk"), all, bulk.handler());
  std::atomic<std::size_t> bulk_before{0};  // what had come when the newest control message came
  Inbox control;
  SubscriptionOptions urgent;
  urgent.priority = urgent_priority;
  const auto control_reader =
      broker->subscribe(topic("control"), urgent, [&, keep = control.handler()](Delivery delivery) {
        bulk_before = bulk.size();
        keep(std::move(delivery));
      });
  PublisherOptions sending;
  sending.priority = urgent_priority;
  const auto controller = broker->publisher(topic("control"), sending);
  ASSERT_TRUE(eventually([&] { return bulk_reader->active() && control_reader->active(); }));
  const auto publisher = broker->publisher(topic("bulk"), {});
  const Payload large = Payload::copy(std::string(1'000'000, 'b'));
  // On a busy machine all bulk data may be through before the control message is sent; never again and again.
  bool overtook = false;
  for (std::size_t round = 1; round <= 5 && !overtook; ++round) {
    for (int i = 0; i < bulk_messages; ++i) {
      ASSERT_EQ(publisher->publish(Message{large, "driver", "", 0, {}}), PublishStatus::accepted);
    }
    controller->publish(text_message("stop"));
    ASSERT_TRUE(control.wait_for(round));
    overtook = bulk_before < bulk_messages;
    EXPECT_TRUE(publisher->drain(patience));
    ASSERT_TRUE(bulk.wait_for(bulk_messages));
    for (std::size_t i = 0; i < bulk_messages; ++i) bulk.settle(i, Settlement::accept);
    bulk.drop_all();
  }
  EXPECT_TRUE(overtook) << "it came after all bulk data";
}

TEST_F(RabbitMqConnections, AnUrgentHandlerRunsWhileAnotherOneTakesLong) {
  const auto broker = this->broker();
  std::promise<void> entered;
  std::promise<void> leave;
  const auto slow = broker->subscribe(topic("slow"), {}, [&](Delivery delivery) {
    entered.set_value();
    leave.get_future().wait_for(patience);
    delivery.settle(Settlement::accept);
  });
  Inbox control;
  SubscriptionOptions urgent;
  urgent.priority = urgent_priority;
  const auto control_reader = broker->subscribe(topic("beside"), urgent, control.handler());
  const auto publisher = broker->publisher(topic("slow"), {});
  publisher->publish(text_message("x"));
  ASSERT_EQ(entered.get_future().wait_for(patience), std::future_status::ready);
  const auto controller = broker->publisher(topic("beside"), {});
  controller->publish(text_message("stop"));
  EXPECT_TRUE(control.wait_for(1));
  leave.set_value();
}

TEST_F(RabbitMqConnections, PropertiesThatCannotBeAreRefusedWithTheReason) {
  const std::map<std::string, std::string> wrong{
      {"queue_types", "quorum"}, {"queue_type", "stream"}, {"channels_per_connection", "many"}};
  for (const auto& property : wrong) {
    try {
      broker({property});
      ADD_FAILURE() << property.first << " was taken";
    } catch (const config::Error& error) {
      EXPECT_THAT(error.what(), testing::HasSubstr(property.first));
    }
  }
}

}  // namespace
}  // namespace iotcloud::brokers
