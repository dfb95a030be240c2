// What handlers publish is kept back until what came together is handled, and never longer than that may take.
#include "iotcloud/brokers/kafka/gathering.h"

#include <atomic>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

TEST(KafkaGathering, EndsEachTargetOnceAndBeginsAnew) {
  int ended = 0;
  const auto target = std::make_shared<kafka::Gathering::Target>([&] { ++ended; });
  kafka::Gathering gathering;
  ASSERT_EQ(kafka::Gathering::of_this_thread(), &gathering);
  gathering.add(target, kafka::Gathering::Instant{std::chrono::seconds(1)});
  gathering.add(target, kafka::Gathering::Instant{std::chrono::seconds(2)});
  EXPECT_EQ(gathering.began(), kafka::Gathering::Instant{std::chrono::seconds(1)});
  gathering.end();
  EXPECT_EQ(ended, 1);
  EXPECT_TRUE(gathering.empty());
  gathering.end();
  EXPECT_EQ(ended, 1);
}

TEST(KafkaGathering, CallsNoTargetThatIsClosed) {
  int ended = 0;
  const auto target = std::make_shared<kafka::Gathering::Target>([&] { ++ended; });
  kafka::Gathering gathering;
  gathering.add(target, {});
  target->close();
  gathering.end();
  EXPECT_EQ(ended, 0);
}

class KafkaGatheringServer : public testing::Test {
 protected:
  static constexpr int messages = 300;

  KafkaGatheringServer() {
    BrokerOptions options;
    options.urls = {server_.url()};
    options.heartbeat = std::chrono::seconds(2);
    broker_ = make_broker(options);
  }
  Topic topic(const std::string& name) const { return {"", "gw.driver." + name, false}; }
  void send_all() {
    source_ = broker_->publisher(topic("in"), {});
    for (int i = 0; i < messages; ++i) {
      ASSERT_EQ(source_->publish(text_message(std::to_string(i))), PublishStatus::accepted);
    }
    ASSERT_TRUE(source_->drain(patience));
  }

  tests::PrivateServer server_{"kafka.py", {"--partitions", "1"}};
  std::unique_ptr<Broker> broker_;
  std::unique_ptr<Publisher> source_;
};

TEST_F(KafkaGatheringServer, WhatHandlersPublishArrivesInOrder) {
  const auto out = broker_->publisher(topic("out"), {});
  Inbox inbox;
  const auto reader = broker_->subscribe(topic("out"), {}, inbox.handler());
  const auto echo = broker_->subscribe(topic("in"), {}, [&](Delivery delivery) {
    EXPECT_EQ(out->publish(delivery.message), PublishStatus::accepted);
    delivery.settle(Settlement::accept);
  });
  send_all();
  ASSERT_TRUE(inbox.wait_for(messages));
  std::vector<std::string> expected;
  expected.reserve(messages);
  for (int i = 0; i < messages; ++i) expected.push_back(std::to_string(i));
  EXPECT_EQ(inbox.bodies(), expected);
  EXPECT_TRUE(out->drain(patience));
}

TEST_F(KafkaGatheringServer, GatheringsOfSeveralThreadsTakeWhatTheLinksOwnThreadIsAboutToTake) {
  constexpr int topics = 32, rounds = 500;
  PublisherOptions options;
  options.capacity = 1'000'000;
  std::vector<std::unique_ptr<Publisher>> publishers;
  publishers.reserve(topics);
  for (int i = 0; i < topics; ++i) publishers.push_back(broker_->publisher(topic("out" + std::to_string(i)), options));
  std::vector<std::jthread> threads;
  threads.reserve(3);
  for (int i = 0; i < 3; ++i) {
    threads.emplace_back([&] {
      for (int round = 0; round < rounds; ++round) {
        kafka::Gathering gathering;  // as a reader's thread has one
        for (const auto& publisher : publishers) {
          EXPECT_EQ(publisher->publish(text_message("x")), PublishStatus::accepted);
        }
        gathering.end();
        EXPECT_TRUE(publishers.back()->drain(patience));  // so that the next may go at once
      }
    });
  }
  threads.clear();
  for (const auto& publisher : publishers) EXPECT_TRUE(publisher->drain(patience));
}

TEST_F(KafkaGatheringServer, AHandlerMayWaitForTheOutcomeOfWhatItPublishes) {
  send_all();
  const auto out = broker_->publisher(topic("out"), {});
  std::atomic<int> handled = 0, confirmed = 0;
  const auto echo = broker_->subscribe(topic("in"), {}, [&](Delivery delivery) {
    const int number = ++handled;
    out->publish(delivery.message);
    // In between, so that the next one is kept back from its first message on.
    if (number % 7 == 0 && out->drain(patience)) ++confirmed;
    delivery.settle(Settlement::accept);
  });
  EXPECT_TRUE(tests::eventually([&] { return handled == messages; }, patience));
  EXPECT_EQ(confirmed, messages / 7);
}

TEST_F(KafkaGatheringServer, AHandlerMayEndTheBrokerThatItPublishedTo) {
  send_all();
  BrokerOptions options;
  options.urls = {server_.url()};
  std::atomic<int> handled = 0;
  const auto echo = broker_->subscribe(topic("in"), {}, [&](Delivery delivery) {
    if (handled < 3) {
      const auto other = make_broker(options);
      const auto out = other->publisher(topic("out"), {});
      for (int i = 0; i < 10; ++i) out->publish(delivery.message);
      EXPECT_TRUE(out->drain(patience));
      for (int i = 0; i < 10; ++i) out->publish(delivery.message);
    }
    ++handled;
    delivery.settle(Settlement::accept);
  });
  EXPECT_TRUE(tests::eventually([&] { return handled == messages; }, patience));
}

}  // namespace
}  // namespace iotcloud::brokers
