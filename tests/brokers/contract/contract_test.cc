// What every broker guarantees while its server is up. contract_reading_test.cc covers reading,
// contract_settlement_test.cc settling, contract_failure_test.cc the rest.
#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
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

TEST_P(BrokerContract, CarriesPayloadsOfEverySizeUnchanged) {
  constexpr std::size_t frame = 131072 - 8;
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  const std::vector<std::size_t> sizes{0,         1,         7,         100,       60'000,
                                       frame - 1, frame,     frame + 1, 2 * frame, 3 * frame - 1,
                                       3 * frame, 1'000'000, 2'097'152, 8'388'608};
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
  for (std::uint64_t i = 1; i <= 3000; ++i) {
    const Published published = publisher->publish(text_message(std::to_string(i)));
    ASSERT_EQ(published, PublishStatus::accepted);
    ASSERT_EQ(published.number, i);
  }
  ASSERT_TRUE(inbox.wait_for(3000));
  EXPECT_EQ(inbox.bodies(), numbered(1, 3000));
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 3000U);
  EXPECT_TRUE(outcomes.each_once());
}

TEST_P(BrokerContract, KeepsTheOrderOfEachThreadThatPublishesAndNumbersEachMessageOnce) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  PublisherOptions options;
  options.capacity = 4000;
  const auto publisher = broker->publisher(topic, options);
  std::array<std::vector<std::uint64_t>, 3> numbers;  // by thread
  {
    std::vector<std::jthread> threads;
    for (std::size_t thread = 0; thread < numbers.size(); ++thread) {
      threads.emplace_back([&, thread] {
        for (int i = 0; i < 500; ++i) {
          const auto body = static_cast<char>('a' + thread) + std::to_string(i);
          numbers[thread].push_back(publisher->publish(text_message(body)).number);
        }
      });
    }
  }
  std::set<std::uint64_t> all;
  for (const auto& of_thread : numbers) {
    EXPECT_TRUE(std::is_sorted(of_thread.begin(), of_thread.end()));
    all.insert(of_thread.begin(), of_thread.end());
  }
  EXPECT_EQ(all.size(), 1500U);
  EXPECT_EQ(*all.begin(), 1U);
  EXPECT_EQ(*all.rbegin(), 1500U);
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

TEST_P(BrokerContract, AMessageThatNobodyReadsWaitsForAReader) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Outcomes outcomes;
  PublisherOptions options;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  const auto begun = config::system_clock().now();
  for (const auto& body : numbered(1, 30)) ASSERT_EQ(publisher->publish(text_message(body)), PublishStatus::accepted);
  if (server().keeps_unread()) {
    EXPECT_TRUE(publisher->drain(patience));
  } else {
    EXPECT_FALSE(outcomes.wait_for(1, moment));
    EXPECT_EQ(publisher->pending(), 30U);
    const auto oldest = publisher->oldest();
    ASSERT_TRUE(oldest);
    EXPECT_GE(*oldest, begun);
    EXPECT_LE(*oldest, config::system_clock().now());
    EXPECT_FALSE(publisher->drain(std::chrono::milliseconds(1)));
  }
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for(30));
  EXPECT_EQ(inbox.bodies(), numbered(1, 30));
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 30U);
  EXPECT_EQ(publisher->pending(), 0U);
  EXPECT_FALSE(publisher->oldest());
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
  const auto held_up = hold_up(*broker);
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
  if (held_up) held_up->end();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_EQ(room.wait_for(patience), std::future_status::ready);
  ASSERT_TRUE(eventually([&] { return publisher->publish(text_message("6")) == PublishStatus::accepted; }));
  ASSERT_TRUE(inbox.wait_for_last("6"));
  EXPECT_EQ(firsts(inbox), numbered(1, 6));
  ASSERT_TRUE(outcomes.wait_for(6));
  EXPECT_EQ(outcomes.of(6), Outcome::confirmed) << "what was refused with would_block takes no number";
}

TEST_P(BrokerContract, KeepNewestDropsTheOldestThatWaits) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  const auto held_up = hold_up(*broker);
  Outcomes outcomes;
  PublisherOptions options;
  options.when_full = WhenFull::keep_newest;
  options.capacity = 4;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  for (const auto& body : numbered(1, 100)) ASSERT_EQ(publisher->publish(text_message(body)), PublishStatus::accepted);
  ASSERT_TRUE(outcomes.wait_for(92));
  ASSERT_TRUE(eventually([&] { return !outcomes.reason(1).empty(); })) << "it may have been under way";
  EXPECT_EQ(outcomes.of(1), Outcome::dropped);
  if (held_up) held_up->end();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for_last("100"));
  const auto bodies = firsts(inbox);
  EXPECT_LE(bodies.size(), 8U);
  EXPECT_EQ(std::vector<std::string>(bodies.end() - 4, bodies.end()), numbered(97, 100));
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.size(), 100U);
  EXPECT_TRUE(outcomes.each_once());
  EXPECT_EQ(outcomes.count(Outcome::confirmed), bodies.size());
}

TEST_P(BrokerContract, AMessageBeyondItsDeadlineIsDroppedWhereItWaits) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  const auto held_up = hold_up(*broker);
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
  const auto held_up = hold_up(*broker);
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
  const Published first = publisher->publish(long_name);
  const Published second = publisher->publish(much);
  const Published third = publisher->publish(text_message("3"));
  for (const Published& published : {first, second, third}) EXPECT_EQ(published, PublishStatus::accepted);
  ASSERT_TRUE(inbox.wait_for(1));
  EXPECT_THAT(inbox.bodies(), ElementsAre("3"));
  ASSERT_TRUE(outcomes.wait_for(3));
  EXPECT_EQ(outcomes.of(first.number), Outcome::refused);
  EXPECT_EQ(outcomes.of(second.number), Outcome::refused);
  EXPECT_EQ(outcomes.of(third.number), Outcome::confirmed);
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
