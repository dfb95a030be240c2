// How every broker delivers messages: to whom, how many at once, and in which order they may be settled.
#include <atomic>
#include <future>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"

namespace iotcloud::brokers {
namespace {

using testing::ElementsAre;

TEST_P(BrokerContract, UnsettledMessagesOfASubscriptionThatEndsGoToTheNextOne) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Holder holder;
  Inbox inbox;
  auto subscription = broker->subscribe(topic, {}, holder.handler());
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 4)) publisher->publish(text_message(body));
  ASSERT_TRUE(holder.wait_for(4));
  holder.settle(1, Settlement::accept);
  subscription.reset();
  subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for(3));
  EXPECT_THAT(inbox.bodies(), ElementsAre("1", "3", "4"));
  for (const auto& received : inbox.all()) EXPECT_TRUE(received.redelivered);
  holder.drop_all();  // too late: ignored
  publisher->publish(text_message("5"));
  ASSERT_TRUE(inbox.wait_for(4));
  EXPECT_EQ(inbox.bodies().back(), "5");
}

TEST_P(BrokerContract, WhatSeveralReadersLeftOneAfterTheOtherComesInOrder) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  SubscriptionOptions options;
  options.prefetch = 60;
  Holder first;
  Holder second;
  Inbox third;
  auto subscription = broker->subscribe(topic, options, first.handler());
  await_active(*subscription);
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 60)) publisher->publish(text_message(body));
  ASSERT_TRUE(first.wait_for(60));
  subscription.reset();
  first.drop_all();
  // It takes a part of them, and leaves.
  options.prefetch = 20;
  subscription = broker->subscribe(topic, options, second.handler());
  ASSERT_TRUE(second.wait_for(20));
  subscription.reset();
  second.drop_all();
  subscription = broker->subscribe(topic, options, third.handler());
  for (const auto& body : numbered(61, 70)) publisher->publish(text_message(body));
  ASSERT_TRUE(third.wait_for(70));
  EXPECT_EQ(third.bodies(), numbered(1, 70));
}

TEST_P(BrokerContract, EveryGroupGetsEverything) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox own;
  Inbox one;
  Inbox two;
  const auto own_subscription = broker->subscribe(topic, {}, own.handler());
  SubscriptionOptions options;
  options.group = "one";
  const auto first = broker->subscribe(topic, options, one.handler());
  options.group = "two";
  const auto second = broker->subscribe(topic, options, two.handler());
  await_active(*own_subscription);
  await_active(*first);
  await_active(*second);
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 50)) publisher->publish(text_message(body));
  for (Inbox* inbox : {&own, &one, &two}) {
    ASSERT_TRUE(inbox->wait_for(50));
    EXPECT_EQ(inbox->bodies(), numbered(1, 50));
  }
}

TEST_P(BrokerContract, AnExclusiveReadersStandbyTakesOverWhenItEnds) {
  const auto broker = this->broker();
  const auto other = this->broker();
  const Topic topic = this->topic();
  Inbox first_inbox;
  Inbox second_inbox;
  auto first = broker->subscribe(topic, {}, first_inbox.handler());
  await_active(*first);
  const bool may_take_over_at_once = GetParam() == "kafka";  // which gives the partition to any of its members
  std::unique_ptr<Subscription> second;
  const auto stand_by = [&] { second = other->subscribe(topic, {}, second_inbox.handler()); };
  if (!may_take_over_at_once) stand_by();
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 20)) publisher->publish(text_message(body));
  ASSERT_TRUE(first_inbox.wait_for(20));
  if (may_take_over_at_once) {
    stand_by();
  } else {
    EXPECT_FALSE(second->active());
    EXPECT_EQ(second_inbox.size(), 0U);
  }
  first.reset();
  await_active(*second);
  for (const auto& body : numbered(21, 30)) publisher->publish(text_message(body));
  ASSERT_TRUE(second_inbox.wait_for(10));
  EXPECT_EQ(second_inbox.bodies(), numbered(21, 30));
}

TEST_P(BrokerContract, ReadersThatAreNotExclusiveShareAQueue) {
  const auto properties = server().sharing_properties();
  const auto broker = this->broker(properties);
  const auto other = this->broker(properties);
  const Topic topic = this->topic();
  SubscriptionOptions options;
  options.exclusive = false;
  options.prefetch = 1;
  Holder one;
  Holder two;
  const auto first = broker->subscribe(topic, options, one.handler());
  const auto second = other->subscribe(topic, options, two.handler());
  await_active(*first);
  await_active(*second);
  const auto publisher = broker->publisher(topic, {});
  // Records are shared out by key, and two messages may go to one reader; of this many keys each reader gets some.
  const int messages = properties.empty() ? 2 : 20;
  for (int i = 1; i <= messages; ++i) {
    Message message = text_message(std::to_string(i));
    message.driver_id = "driver " + std::to_string(i);
    publisher->publish(message);
  }
  EXPECT_TRUE(one.wait_for(1));
  EXPECT_TRUE(two.wait_for(1));
}

/// A reader that settles nothing by itself, and a publisher that has sent so many messages.
struct HoldingReader {
  HoldingReader(Broker& broker, const Topic& topic, const SubscriptionOptions& options, int messages)
      : subscription(broker.subscribe(topic, options, holder.handler())), publisher(broker.publisher(topic, {})) {
    for (const auto& body : numbered(1, messages)) publisher->publish(text_message(body));
  }
  Holder holder;
  const std::unique_ptr<Subscription> subscription;
  const std::unique_ptr<Publisher> publisher;
};

TEST_P(BrokerContract, NeverHandsOutMoreThanThePrefetch) {
  const auto broker = this->broker();
  SubscriptionOptions options;
  options.prefetch = 5;
  HoldingReader held(*broker, topic(), options, 20);
  ASSERT_TRUE(held.publisher->drain(patience));
  ASSERT_TRUE(held.holder.wait_for(5));
  EXPECT_FALSE(held.holder.wait_for(6, moment));
  held.holder.settle(0, Settlement::accept);
  held.holder.settle(1, Settlement::accept);
  ASSERT_TRUE(held.holder.wait_for(7));
  EXPECT_FALSE(held.holder.wait_for(8, moment));
  held.holder.drop_all();
}

TEST_P(BrokerContract, ARaisedPrefetchLetsMoreMessagesComeWhileNoneIsSettled) {
  const auto broker = this->broker();
  SubscriptionOptions options;
  options.prefetch = 5;
  options.prefetch_limit = 40;
  HoldingReader held(*broker, topic(), options, 100);
  ASSERT_TRUE(held.holder.wait_for(5));
  EXPECT_FALSE(held.holder.wait_for(6, moment));
  EXPECT_TRUE(held.subscription->raise_prefetch(20));
  ASSERT_TRUE(held.holder.wait_for(20));
  EXPECT_FALSE(held.holder.wait_for(21, moment));
  EXPECT_FALSE(held.subscription->raise_prefetch(41)) << "more than its limit";
  EXPECT_TRUE(held.subscription->raise_prefetch(10)) << "fewer than before: nothing changes";
  for (std::size_t i = 0; i < 10; ++i) held.holder.settle(i, Settlement::accept);
  ASSERT_TRUE(held.holder.wait_for(30));
  EXPECT_FALSE(held.holder.wait_for(31, moment));
  EXPECT_TRUE(held.subscription->raise_prefetch(40));
  ASSERT_TRUE(held.holder.wait_for(50));
  held.holder.drop_all();
}

TEST_P(BrokerContract, SaysHowManyMessagesWaitForAReader) {
  const auto broker = this->broker();
  SubscriptionOptions options;
  options.prefetch = 5;
  HoldingReader held(*broker, topic(), options, 100);
  ASSERT_TRUE(held.holder.wait_for(5));
  if (GetParam() == "activemq") {
    EXPECT_EQ(held.subscription->backlog(), std::nullopt);
  } else {
    EXPECT_TRUE(tests::eventually([&] { return held.subscription->backlog() == 95; }));
    for (std::size_t i = 0; i < 5; ++i) held.holder.settle(i, Settlement::accept);
    EXPECT_TRUE(tests::eventually([&] { return held.subscription->backlog() == 90; }));
  }
  held.holder.drop_all();
}

TEST_P(BrokerContract, SettlesOutOfOrderWithoutStalling) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Holder holder;
  SubscriptionOptions options;
  options.prefetch = 10;
  const auto subscription = broker->subscribe(topic, options, holder.handler());
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 100)) publisher->publish(text_message(body));
  // The first stays unsettled for ever: it must not keep the others from flowing.
  for (std::size_t i = 1; i < 100; ++i) {
    ASSERT_TRUE(holder.wait_for(i + 1)) << "stalled after " << i;
    holder.settle(i, Settlement::accept);
  }
  holder.settle(0, Settlement::accept);
}

TEST_P(BrokerContract, AutomaticAcknowledgementNeedsNoSettlement) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Holder holder;
  Inbox inbox;
  SubscriptionOptions options;
  options.automatic_ack = true;
  options.prefetch = 5;
  auto subscription = broker->subscribe(topic, options, holder.handler());
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 50)) publisher->publish(text_message(body));
  ASSERT_TRUE(holder.wait_for(50));
  holder.drop_all();
  subscription.reset();
  subscription = broker->subscribe(topic, options, inbox.handler());
  publisher->publish(text_message("51"));
  ASSERT_TRUE(inbox.wait_for(1));
  EXPECT_THAT(inbox.bodies(), ElementsAre("51"));
}

TEST_P(BrokerContract, APausedSubscriptionTakesNothingAndGoesOnInOrder) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(inbox.wait_for(1));
  subscription->pause();
  for (const auto& body : numbered(2, 300)) publisher->publish(text_message(body));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_FALSE(inbox.wait_for(2, moment));
  subscription->resume();
  ASSERT_TRUE(inbox.wait_for(300));
  EXPECT_EQ(inbox.bodies(), numbered(1, 300));
}

TEST_P(BrokerContract, KeepLastHandsOnOnlyTheNewestOfWhatWaits) {
  config::Metrics metrics;
  BrokerOptions counting;
  counting.urls = {server().url()};
  counting.metrics = &metrics;
  const auto broker = make_broker(counting);
  const Topic topic = this->topic();
  Inbox inbox;
  SubscriptionOptions options;
  options.keep_last = 3;
  const auto subscription = broker->subscribe(topic, options, inbox.handler());
  await_active(*subscription);
  const auto publisher = broker->publisher(topic, {});
  const Topic later = this->topic();
  Inbox fence;
  const auto other = broker->subscribe(later, {}, fence.handler());
  const auto fence_publisher = broker->publisher(later, {});
  int sent = 0;
  std::vector<std::string> bodies;
  do {
    ASSERT_LT(sent, 1000) << "what waited was to be skipped";
    subscription->pause();
    for (const auto& body : numbered(sent + 1, sent + 50)) publisher->publish(text_message(body));
    sent += 50;
    ASSERT_TRUE(publisher->drain(patience));
    // A confirmed message is at the server. When a message sent later on another topic has arrived, all of the first
    // topic's are here if both topics are in one place. Of a server some are, unless it or this machine is busy: then
    // once more.
    fence_publisher->publish(text_message("x"));
    ASSERT_TRUE(fence.wait_for(static_cast<std::size_t>(sent / 50)));
    subscription->resume();
    ASSERT_TRUE(inbox.wait_for_last(std::to_string(sent)));
    bodies = firsts(inbox);
  } while (server().process() != nullptr && bodies.size() == static_cast<std::size_t>(sent));
  if (server().process() == nullptr) {
    EXPECT_LE(bodies.size(), 3U) << "what waited was to be skipped";
  }
  EXPECT_GE(bodies.size() + metrics.counter("iotcloud_broker_conflated_total", "", {{"broker", GetParam()}}).value(),
            static_cast<std::size_t>(sent));
  EXPECT_EQ(std::vector<std::string>(bodies.end() - 3, bodies.end()), numbered(sent - 2, sent));
}

TEST_P(BrokerContract, TheDestructorOfASubscriptionWaitsForItsHandler) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  std::promise<void> entered;
  std::atomic<bool> leave{false};
  std::atomic<bool> left{false};
  auto subscription = broker->subscribe(topic, {}, [&](Delivery delivery) {
    entered.set_value();
    while (!leave) std::this_thread::yield();
    delivery.settle(Settlement::accept);
    left = true;
  });
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("x"));
  ASSERT_EQ(entered.get_future().wait_for(patience), std::future_status::ready);
  auto ending = std::async(std::launch::async, [&] { subscription.reset(); });
  EXPECT_EQ(ending.wait_for(std::chrono::milliseconds(50)), std::future_status::timeout);
  leave = true;
  ending.get();
  EXPECT_TRUE(left);
}

TEST_P(BrokerContract, AHandlerMayEndItsOwnSubscription) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  std::unique_ptr<Subscription> subscription;
  std::promise<void> ended;
  std::mutex mutex;
  {
    const std::lock_guard lock(mutex);
    subscription = broker->subscribe(topic, {}, [&](Delivery delivery) {
      delivery.settle(Settlement::accept);
      const std::lock_guard inner(mutex);
      subscription.reset();
      ended.set_value();
    });
  }
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("x"));
  ASSERT_EQ(ended.get_future().wait_for(patience), std::future_status::ready);
}

TEST_P(BrokerContract, AHandlerMayPublish) {
  const auto broker = this->broker();
  const Topic there = this->topic();
  const Topic back = this->topic();
  Inbox inbox;
  const auto answers = broker->subscribe(back, {}, inbox.handler());
  const auto reply = broker->publisher(back, {});
  const auto echo = broker->subscribe(there, {}, [&](Delivery delivery) {
    reply->publish(delivery.message);
    delivery.settle(Settlement::accept);
  });
  const auto publisher = broker->publisher(there, {});
  for (const auto& body : numbered(1, 200)) publisher->publish(text_message(body));
  ASSERT_TRUE(inbox.wait_for(200));
  EXPECT_EQ(inbox.bodies(), numbered(1, 200));
}

}  // namespace
}  // namespace iotcloud::brokers
