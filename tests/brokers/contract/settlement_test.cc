// How every broker settles messages: accepted, retried in order, rejected, dead letters.
#include <algorithm>
#include <atomic>
#include <future>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"

namespace iotcloud::brokers {
namespace {

using testing::ElementsAre;

TEST_P(BrokerContract, AnAcceptedMessageIsNotDeliveredAgain) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox first;
  Inbox second;
  auto subscription = broker->subscribe(topic, {}, first.handler());
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 10)) publisher->publish(text_message(body));
  ASSERT_TRUE(first.wait_for(10));
  subscription.reset();
  subscription = broker->subscribe(topic, {}, second.handler());
  publisher->publish(text_message("11"));
  ASSERT_TRUE(second.wait_for(1));
  EXPECT_THAT(second.bodies(), ElementsAre("11"));
}

TEST_P(BrokerContract, ARetriedMessageComesAgainBeforeWhatFollowsAndIsFlagged) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox([](const Inbox::Received& received) {
    return received.body == "2" && !received.redelivered ? Settlement::retry : Settlement::accept;
  });
  SubscriptionOptions options;
  options.prefetch = 1;
  const auto subscription = broker->subscribe(topic, options, inbox.handler());
  await_active(*subscription);
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 4)) publisher->publish(text_message(body));
  ASSERT_TRUE(inbox.wait_for(5));
  const auto all = inbox.all();
  EXPECT_THAT(inbox.bodies(), ElementsAre("1", "2", "2", "3", "4"));
  EXPECT_FALSE(all[0].redelivered);
  EXPECT_FALSE(all[1].redelivered);
  EXPECT_TRUE(all[2].redelivered);
}

TEST_P(BrokerContract, RetryKeepsTheOrderAlsoWithALargePrefetch) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox([](const Inbox::Received& received) {
    return received.body == "3" && !received.redelivered ? Settlement::retry : Settlement::accept;
  });
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  subscription->pause();
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 20)) publisher->publish(text_message(body));
  ASSERT_TRUE(publisher->drain(patience));
  subscription->resume();
  ASSERT_TRUE(inbox.wait_for(21));
  std::vector<std::string> expected = numbered(1, 20);
  expected.insert(expected.begin() + 2, "3");
  EXPECT_EQ(inbox.bodies(), expected);
}

TEST_P(BrokerContract, NothingOvertakesARetriedMessageWhileOthersKeepComing) {
  constexpr int total = 4000;
  const auto broker = this->broker();
  const Topic topic = this->topic();
  std::mutex mutex;
  std::vector<int> accepted;
  std::set<int> retried;
  std::promise<void> done;
  SubscriptionOptions reading;
  reading.prefetch = 50;
  const auto subscription = broker->subscribe(topic, reading, [&](Delivery delivery) {
    const int number = std::stoi(std::string(delivery.message.payload.text()));
    const std::lock_guard lock(mutex);
    if (number % 500 == 0 && retried.insert(number).second) return;  // dropped unsettled: retry
    delivery.settle(Settlement::accept);
    accepted.push_back(number);
    if (number == total) done.set_value();
  });
  await_active(*subscription);
  PublisherOptions options;
  options.capacity = total;
  const auto publisher = broker->publisher(topic, options);
  for (int i = 1; i <= total; ++i) publisher->publish(text_message(std::to_string(i)));
  ASSERT_EQ(done.get_future().wait_for(patience), std::future_status::ready);
  const std::lock_guard lock(mutex);
  EXPECT_EQ(retried.size(), 8U);
  EXPECT_EQ(accepted.size(), static_cast<std::size_t>(total));
  for (const int number : retried) {
    const auto place = std::find(accepted.begin(), accepted.end(), number);
    EXPECT_TRUE(std::all_of(accepted.begin(), place, [&](int earlier) { return earlier < number; }))
        << "something overtook " << number;
  }
}

TEST_P(BrokerContract, ARejectedMessageNeverComesAgain) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox(
      [](const Inbox::Received& received) { return received.body == "1" ? Settlement::reject : Settlement::accept; });
  auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("1"));
  publisher->publish(text_message("2"));
  ASSERT_TRUE(inbox.wait_for(2));
  subscription.reset();
  subscription = broker->subscribe(topic, {}, inbox.handler());
  publisher->publish(text_message("3"));
  ASSERT_TRUE(inbox.wait_for(3));
  EXPECT_THAT(inbox.bodies(), ElementsAre("1", "2", "3"));
}

TEST_P(BrokerContract, CountsHowOftenItHandedAMessageOn) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  std::mutex mutex;
  std::vector<std::uint32_t> tries;
  std::promise<void> done;
  const auto subscription = broker->subscribe(topic, {}, [&](Delivery delivery) {
    const std::lock_guard lock(mutex);
    tries.push_back(delivery.tries);
    if (delivery.tries < 3) return;  // dropped unsettled: retry
    delivery.settle(Settlement::accept);
    done.set_value();
  });
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("x"));
  ASSERT_EQ(done.get_future().wait_for(patience), std::future_status::ready);
  const std::lock_guard lock(mutex);
  EXPECT_THAT(tries, ElementsAre(1, 2, 3));
}

TEST_P(BrokerContract, WhatIsRetriedTooOftenGoesToTheDeadLetterTopicInItsTurn) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  const Topic dead{"", topic.name + ".dead", true};
  Inbox inbox(
      [](const Inbox::Received& received) { return received.body == "2" ? Settlement::retry : Settlement::accept; });
  SubscriptionOptions options;
  options.group = "readers";
  options.max_tries = 3;
  options.dead_letter = dead.name;
  auto subscription = broker->subscribe(topic, options, inbox.handler());
  await_active(*subscription);
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 3)) publisher->publish(text_message(body));
  ASSERT_TRUE(inbox.wait_for(5));
  EXPECT_THAT(inbox.bodies(), ElementsAre("1", "2", "2", "2", "3"));
  Inbox letters;
  const auto reader = broker->subscribe(dead, {}, letters.handler());
  ASSERT_TRUE(letters.wait_for(1));
  const Message letter = letters.all().front().message;
  EXPECT_EQ(letter.payload.text(), "2");
  EXPECT_EQ(letter.driver_id, "driver");
  EXPECT_EQ(*letter.properties.find("dead-letter-reason"), "retried too often");
  EXPECT_EQ(*letter.properties.find("dead-letter-tries"), "3");
  EXPECT_EQ(*letter.properties.find("dead-letter-topic"), topic.name);
}

TEST_P(BrokerContract, WhatIsRejectedGoesToTheDeadLetterTopicAtOnce) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  const Topic dead{"", topic.name + ".dead", true};
  Inbox inbox(
      [](const Inbox::Received& received) { return received.body == "1" ? Settlement::reject : Settlement::accept; });
  SubscriptionOptions options;
  options.dead_letter = dead.name;
  const auto subscription = broker->subscribe(topic, options, inbox.handler());
  await_active(*subscription);
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 2)) publisher->publish(text_message(body));
  Inbox letters;
  const auto reader = broker->subscribe(dead, {}, letters.handler());
  ASSERT_TRUE(letters.wait_for(1));
  EXPECT_EQ(letters.bodies().front(), "1");
  ASSERT_TRUE(inbox.wait_for(2));
}

TEST_P(BrokerContract, AHandlerThatThrowsGetsTheMessageAgain) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  std::atomic<int> calls{0};
  std::promise<bool> redelivered;
  const auto subscription = broker->subscribe(topic, {}, [&](Delivery delivery) {
    if (++calls == 1) throw std::runtime_error("the handler's own trouble");
    if (calls == 2) redelivered.set_value(delivery.redelivered);
    delivery.settle(Settlement::accept);
  });
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("x"));
  auto second = redelivered.get_future();
  ASSERT_EQ(second.wait_for(patience), std::future_status::ready);
  EXPECT_TRUE(second.get());
}

}  // namespace
}  // namespace iotcloud::brokers
