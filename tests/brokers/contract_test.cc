// What every broker promises while its server is there. contract_failure_test.cc has the rest.
#include <algorithm>
#include <atomic>
#include <future>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"

namespace iotcloud::brokers {
namespace {

using testing::ElementsAre;

std::vector<std::string> numbered(int from, int to) {
  std::vector<std::string> bodies;
  for (int i = from; i <= to; ++i) bodies.push_back(std::to_string(i));
  return bodies;
}

TEST_P(BrokerContract, CarriesPayloadsOfEverySizeUnchanged) {
  constexpr std::size_t frame = 131072 - 8;
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  const std::vector<std::size_t> sizes{
      0, 1, 7, 100, 60'000, frame - 1, frame, frame + 1, 2 * frame, 3 * frame - 1, 3 * frame, 1'000'000, 2'097'152};
  std::vector<std::string> sent;
  for (const std::size_t size : sizes) {
    std::string body(size, '\0');
    for (std::size_t i = 0; i < size; ++i) body[i] = static_cast<char>((i * 31 + size) >> 3);
    sent.push_back(body);
    ASSERT_EQ(publisher->publish(text_message(body)), PublishStatus::accepted);
  }
  ASSERT_TRUE(inbox.wait_for(sizes.size()));
  const auto received = inbox.bodies();
  for (std::size_t i = 0; i < sizes.size(); ++i) EXPECT_TRUE(received[i] == sent[i]) << "payload of " << sizes[i];
}

TEST_P(BrokerContract, CarriesMetadataOfAnyBytes) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  Message message = text_message("x");
  message.driver_id = std::string("dr\0iver", 7);
  message.gateway_id = "gate\xc3\xa4way";
  message.time_ms = 1'700'000'000'123;
  std::string all_bytes;
  for (int c = 0; c < 256; ++c) all_bytes += static_cast<char>(c);
  message.properties.set("all", all_bytes);
  message.properties.set("empty", "");
  message.properties.set("\xe6\x97\xa5\xe6\x9c\xac", "\xf0\x9f\xa4\x96");
  message.properties.set(std::string("n\0l", 3), std::string(1, '\0'));
  message.properties.set("long", std::string(5000, 'v'));
  ASSERT_EQ(publisher->publish(message), PublishStatus::accepted);
  ASSERT_TRUE(inbox.wait_for(1));
  const Message received = inbox.all().front().message;
  EXPECT_EQ(received.driver_id, message.driver_id);
  EXPECT_EQ(received.gateway_id, message.gateway_id);
  EXPECT_EQ(received.time_ms, message.time_ms);
  EXPECT_EQ(received.properties, message.properties);
}

TEST_P(BrokerContract, KeepsTheOrderOfATopic) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  Outcomes outcomes;
  PublisherOptions options;
  options.capacity = 5000;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  for (int i = 1; i <= 3000; ++i) {
    ASSERT_EQ(publisher->publish(text_message(std::to_string(i))), PublishStatus::accepted);
  }
  ASSERT_TRUE(inbox.wait_for(3000));
  EXPECT_EQ(inbox.bodies(), numbered(1, 3000));
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 3000U);
  EXPECT_TRUE(outcomes.each_once());
}

TEST_P(BrokerContract, KeepsTheOrderOfEachThreadThatPublishes) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  PublisherOptions options;
  options.capacity = 4000;
  const auto publisher = broker->publisher(topic, options);
  {
    std::vector<std::jthread> threads;
    for (char name = 'a'; name < 'd'; ++name) {
      threads.emplace_back([&, name] {
        for (int i = 0; i < 500; ++i) publisher->publish(text_message(name + std::to_string(i)));
      });
    }
  }
  ASSERT_TRUE(inbox.wait_for(1500));
  std::map<char, int> next;
  for (const std::string& body : inbox.bodies()) EXPECT_EQ(body, body[0] + std::to_string(next[body[0]]++));
}

TEST_P(BrokerContract, HandlersDoNotRunOnThePublishersThread) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  std::promise<std::thread::id> handler_thread;
  const auto subscription = broker->subscribe(topic, {}, [&](Delivery delivery) {
    delivery.settle(Settlement::accept);
    handler_thread.set_value(std::this_thread::get_id());
  });
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("x"));
  auto thread = handler_thread.get_future();
  ASSERT_EQ(thread.wait_for(patience), std::future_status::ready);
  EXPECT_NE(thread.get(), std::this_thread::get_id());
}

TEST_P(BrokerContract, AnAcceptedMessageIsNotDeliveredAgain) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox first;
  auto subscription = broker->subscribe(topic, {}, first.handler());
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 10)) publisher->publish(text_message(body));
  ASSERT_TRUE(first.wait_for(10));
  subscription.reset();
  Inbox second;
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

TEST_P(BrokerContract, UnsettledMessagesOfASubscriptionThatEndsGoToTheNextOne) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Holder holder;
  auto subscription = broker->subscribe(topic, {}, holder.handler());
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 4)) publisher->publish(text_message(body));
  ASSERT_TRUE(holder.wait_for(4));
  holder.settle(1, Settlement::accept);
  subscription.reset();
  Inbox inbox;
  subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for(3));
  EXPECT_THAT(inbox.bodies(), ElementsAre("1", "3", "4"));
  for (const auto& received : inbox.all()) EXPECT_TRUE(received.redelivered);
  holder.drop_all();  // too late: ignored
  publisher->publish(text_message("5"));
  ASSERT_TRUE(inbox.wait_for(4));
  EXPECT_EQ(inbox.bodies().back(), "5");
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
  const auto second = other->subscribe(topic, {}, second_inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 20)) publisher->publish(text_message(body));
  ASSERT_TRUE(first_inbox.wait_for(20));
  EXPECT_FALSE(second->active());
  EXPECT_EQ(second_inbox.size(), 0U);
  first.reset();
  await_active(*second);
  for (const auto& body : numbered(21, 30)) publisher->publish(text_message(body));
  ASSERT_TRUE(second_inbox.wait_for(10));
  EXPECT_EQ(second_inbox.bodies(), numbered(21, 30));
}

TEST_P(BrokerContract, ReadersThatAreNotExclusiveShareAQueue) {
  const auto broker = this->broker();
  const auto other = this->broker();
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
  publisher->publish(text_message("1"));
  publisher->publish(text_message("2"));
  EXPECT_TRUE(one.wait_for(1));
  EXPECT_TRUE(two.wait_for(1));
}

TEST_P(BrokerContract, NeverHandsOutMoreThanThePrefetch) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Holder holder;
  SubscriptionOptions options;
  options.prefetch = 5;
  const auto subscription = broker->subscribe(topic, options, holder.handler());
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 20)) publisher->publish(text_message(body));
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(holder.wait_for(5));
  EXPECT_FALSE(holder.wait_for(6, moment));
  holder.settle(0, Settlement::accept);
  holder.settle(1, Settlement::accept);
  ASSERT_TRUE(holder.wait_for(7));
  EXPECT_FALSE(holder.wait_for(8, moment));
  holder.drop_all();
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
  SubscriptionOptions options;
  options.automatic_ack = true;
  options.prefetch = 5;
  auto subscription = broker->subscribe(topic, options, holder.handler());
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 50)) publisher->publish(text_message(body));
  ASSERT_TRUE(holder.wait_for(50));
  holder.drop_all();
  subscription.reset();
  Inbox inbox;
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
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  SubscriptionOptions options;
  options.keep_last = 3;
  const auto subscription = broker->subscribe(topic, options, inbox.handler());
  await_active(*subscription);
  subscription->pause();
  const auto publisher = broker->publisher(topic, {});
  for (const auto& body : numbered(1, 50)) publisher->publish(text_message(body));
  ASSERT_TRUE(publisher->drain(patience));
  subscription->resume();
  ASSERT_TRUE(inbox.wait_until([](const auto& received) { return !received.empty() && received.back().body == "50"; }));
  const auto bodies = inbox.bodies();
  EXPECT_LE(bodies.size(), 10U) << "nearly all of 50 were to be skipped";
  EXPECT_EQ(std::vector<std::string>(bodies.end() - 3, bodies.end()), numbered(48, 50));
}

TEST_P(BrokerContract, AMessageThatNobodyReadsWaitsForAReader) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  for (const auto& body : numbered(1, 30)) ASSERT_EQ(publisher->publish(text_message(body)), PublishStatus::accepted);
  EXPECT_FALSE(outcomes.wait_for(1, moment));
  EXPECT_EQ(publisher->pending(), 30U);
  EXPECT_FALSE(publisher->drain(std::chrono::milliseconds(1)));
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for(30));
  EXPECT_EQ(inbox.bodies(), numbered(1, 30));
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 30U);
  EXPECT_EQ(publisher->pending(), 0U);
}

TEST_P(BrokerContract, ATopicsOwnQueueKeepsWhatIsSentForAReaderThatComesMuchLater) {
  const auto broker = this->broker();
  for (const bool durable : {false, true}) {
    const Topic topic = this->topic(durable);
    Outcomes outcomes;
    PublisherOptions options;
    options.own_queue = true;
    options.on_outcome = outcomes.callback();
    auto publisher = broker->publisher(topic, options);
    publisher->publish(text_message("early"));
    ASSERT_TRUE(outcomes.wait_for(1));
    EXPECT_EQ(outcomes.of(1), Outcome::confirmed);
    publisher.reset();
    Inbox inbox;
    const auto subscription = broker->subscribe(topic, {}, inbox.handler());
    ASSERT_TRUE(inbox.wait_for(1));
    EXPECT_EQ(inbox.bodies().front(), "early");
  }
}

TEST_P(BrokerContract, ATopicsOwnQueueThatIsThereWithOtherPropertiesIsUsedAsItIs) {
  const auto broker = this->broker();
  Topic topic = this->topic(false);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  topic.durable = true;
  PublisherOptions options;
  options.own_queue = true;
  const auto publisher = broker->publisher(topic, options);
  publisher->publish(text_message("through"));
  ASSERT_TRUE(inbox.wait_for(1));
}

TEST_P(BrokerContract, BlockSaysWouldBlockAndThenWritable) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Outcomes outcomes;
  std::promise<void> writable;
  PublisherOptions options;
  options.capacity = 5;
  options.on_outcome = outcomes.callback();
  options.on_writable = [&] { writable.set_value(); };
  const auto publisher = broker->publisher(topic, options);
  for (const auto& body : numbered(1, 5)) ASSERT_EQ(publisher->publish(text_message(body)), PublishStatus::accepted);
  EXPECT_EQ(publisher->publish(text_message("6")), PublishStatus::would_block);
  auto room = writable.get_future();
  EXPECT_EQ(room.wait_for(std::chrono::milliseconds(0)), std::future_status::timeout);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_EQ(room.wait_for(patience), std::future_status::ready);
  ASSERT_TRUE(eventually([&] { return publisher->publish(text_message("6")) == PublishStatus::accepted; }));
  ASSERT_TRUE(inbox.wait_for(6));
  EXPECT_EQ(inbox.bodies(), numbered(1, 6));
  ASSERT_TRUE(outcomes.wait_for(6));
  EXPECT_EQ(outcomes.of(6), Outcome::confirmed) << "what was refused with would_block takes no number";
}

TEST_P(BrokerContract, KeepNewestDropsTheOldestThatWaits) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Outcomes outcomes;
  PublisherOptions options;
  options.when_full = WhenFull::keep_newest;
  options.capacity = 4;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  for (const auto& body : numbered(1, 100)) ASSERT_EQ(publisher->publish(text_message(body)), PublishStatus::accepted);
  ASSERT_TRUE(outcomes.wait_for(92));
  EXPECT_EQ(outcomes.of(1), Outcome::dropped);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(
      inbox.wait_until([](const auto& received) { return !received.empty() && received.back().body == "100"; }));
  EXPECT_LE(inbox.size(), 8U);
  const auto bodies = inbox.bodies();
  EXPECT_EQ(std::vector<std::string>(bodies.end() - 4, bodies.end()), numbered(97, 100));
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.size(), 100U);
  EXPECT_TRUE(outcomes.each_once());
  EXPECT_EQ(outcomes.count(Outcome::confirmed), inbox.size());
}

TEST_P(BrokerContract, AMessageBeyondItsDeadlineIsDroppedWhereItWaits) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Outcomes outcomes;
  PublisherOptions options;
  options.deadline = std::chrono::milliseconds(100);
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  publisher->publish(text_message("stale"));
  ASSERT_TRUE(outcomes.wait_for(1)) << "without a reader, and nothing else happening";
  EXPECT_EQ(outcomes.of(1), Outcome::dropped);
  EXPECT_EQ(outcomes.reason(1), "deadline");
}

TEST_P(BrokerContract, AMessageBeyondItsDeadlineIsDroppedAtTheBroker) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  SubscriptionOptions one_by_one;
  one_by_one.prefetch = 1;
  Holder holder;
  const auto subscription = broker->subscribe(topic, one_by_one, holder.handler());
  await_active(*subscription);
  const auto lasting = broker->publisher(topic, {});
  lasting->publish(text_message("first"));
  ASSERT_TRUE(holder.wait_for(1));
  PublisherOptions options;
  options.deadline = std::chrono::milliseconds(100);
  const auto publisher = broker->publisher(topic, options);
  publisher->publish(text_message("stale"));
  ASSERT_TRUE(publisher->drain(patience));
  lasting->publish(text_message("last"));
  ASSERT_TRUE(lasting->drain(patience));
  EXPECT_FALSE(holder.wait_for(2, moment));  // longer than the deadline
  holder.settle(0, Settlement::accept);
  ASSERT_TRUE(holder.wait_for(2));
  EXPECT_EQ(holder.body(1), "last");
  holder.drop_all();
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

TEST_P(BrokerContract, ClosingAPublisherLosesNothingThatWasConfirmed) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  Outcomes outcomes;
  {
    const auto sender = this->broker();
    PublisherOptions options;
    options.capacity = 2000;
    options.on_outcome = outcomes.callback();
    const auto publisher = sender->publisher(topic, options);
    for (const auto& body : numbered(1, 1000)) publisher->publish(text_message(body));
    EXPECT_TRUE(publisher->drain(patience));
  }
  ASSERT_TRUE(inbox.wait_for(1000));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 1000U);
  EXPECT_TRUE(outcomes.each_once());
}

TEST_P(BrokerContract, APublisherClosedEarlySaysWhatItDoesNotKnow) {
  const auto broker = this->broker();
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  auto publisher = broker->publisher(topic(), options);
  for (const auto& body : numbered(1, 10)) publisher->publish(text_message(body));
  publisher.reset();
  EXPECT_EQ(outcomes.size(), 10U);
  EXPECT_EQ(outcomes.count(Outcome::unknown), 10U);
  EXPECT_TRUE(outcomes.each_once());
}

TEST_P(BrokerContract, RefusesWhatNoBrokerCanCarryAndGoesOn) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  Message long_name = text_message("1");
  long_name.properties.set(std::string(256, 'n'), "v");
  Message much = text_message("2");
  much.properties.set("k", std::string(130'000, 'v'));
  EXPECT_EQ(publisher->publish(long_name), PublishStatus::accepted);
  EXPECT_EQ(publisher->publish(much), PublishStatus::accepted);
  EXPECT_EQ(publisher->publish(text_message("3")), PublishStatus::accepted);
  ASSERT_TRUE(inbox.wait_for(1));
  EXPECT_THAT(inbox.bodies(), ElementsAre("3"));
  ASSERT_TRUE(outcomes.wait_for(3));
  EXPECT_EQ(outcomes.of(1), Outcome::refused);
  EXPECT_EQ(outcomes.of(2), Outcome::refused);
  EXPECT_EQ(outcomes.of(3), Outcome::confirmed);
}

TEST_P(BrokerContract, CarriesAsMuchMetadataAsItSays) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  Message message = text_message("x");
  message.properties.set(std::string(255, 'n'), std::string(119'000, 'v'));
  EXPECT_EQ(publisher->publish(message), PublishStatus::accepted);
  ASSERT_TRUE(inbox.wait_for(1));
  EXPECT_EQ(inbox.all().front().message.properties, message.properties);
}

TEST_P(BrokerContract, ReportsItsState) {
  const auto broker = this->broker();
  EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::connected; }));
  EXPECT_EQ(broker->url(), server().url());
}

}  // namespace
}  // namespace iotcloud::brokers
