// What every broker guarantees when its server goes away and comes back, or a handler takes long.
#include <algorithm>
#include <atomic>
#include <future>
#include <semaphore>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"

namespace iotcloud::brokers {

INSTANTIATE_TEST_SUITE_P(On, BrokerContract, testing::ValuesIn(broker_kinds()),
                         [](const auto& kind) { return kind.param; });

namespace {

TEST_P(BrokerContract, ConnectsWhenTheServerComesAfterTheClients) {
  Outage outage(server());
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  for (int i = 1; i <= 20; ++i) {
    ASSERT_EQ(publisher->publish(text_message(std::to_string(i))), PublishStatus::accepted);
  }
  EXPECT_EQ(broker->state(), ConnectionState::connecting);
  EXPECT_FALSE(subscription->active());
  outage.end();
  ASSERT_TRUE(inbox.wait_for_last("20"));
  EXPECT_EQ(firsts(inbox), numbered(1, 20));
  await_active(*subscription);
}

TEST_P(BrokerContract, ASubscriptionComesBackAfterTheServerDoes) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("before"));
  ASSERT_TRUE(inbox.wait_for(1));
  {
    const Outage outage(server());
    ASSERT_TRUE(eventually([&] { return !subscription->active(); }));
  }
  await_active(*subscription);
  publisher->publish(text_message("after"));
  ASSERT_TRUE(inbox.wait_for_last("after"));
}

TEST_P(BrokerContract, DurableMessagesThatNobodyHasReadSurviveTheServersDeath) {
  const auto broker = this->broker();
  const Topic topic = this->topic(true);
  SubscriptionOptions options;
  options.group = "readers";
  Inbox none;
  Inbox inbox;
  auto subscription = broker->subscribe(topic, options, none.handler());
  await_active(*subscription);
  subscription.reset();
  const auto publisher = broker->publisher(topic, {});
  for (int i = 1; i <= 50; ++i) publisher->publish(text_message(std::to_string(i)));
  ASSERT_TRUE(publisher->drain(patience));
  { const Outage outage(server()); }
  subscription = broker->subscribe(topic, options, inbox.handler());
  ASSERT_TRUE(inbox.wait_for_last("50"));
  EXPECT_EQ(firsts(inbox), numbered(1, 50));
}

TEST_P(BrokerContract, LosesNothingWhenTheServerIsKilledInTheMiddleOfADurableStream) {
  constexpr int total = 5000;
  const auto sender = this->broker();
  const auto reader = this->broker();
  const Topic topic = this->topic(true);
  Inbox inbox;
  SubscriptionOptions reading;
  reading.group = "readers";
  const auto subscription = reader->subscribe(topic, reading, inbox.handler());
  await_active(*subscription);
  Outcomes outcomes;
  PublisherOptions options;
  options.capacity = 500;
  options.on_outcome = outcomes.callback();
  std::counting_semaphore<> writable(0);
  options.on_writable = [&writable] { writable.release(); };
  const auto publisher = sender->publisher(topic, options);
  std::atomic<int> sent{0};
  std::jthread stream([&] {
    for (int i = 1; i <= total; ++i) {
      while (publisher->publish(text_message(std::to_string(i))) != PublishStatus::accepted) {
        if (!writable.try_acquire_for(patience)) return;  // checked below: not all messages were sent
      }
      sent = i;
    }
  });
  ASSERT_TRUE(inbox.wait_for(1000));
  {
    const Outage outage(server());
    // The stream reaches its own limit, and then waits.
    EXPECT_TRUE(eventually([&] { return publisher->pending() >= 500 || sent == total; }));
  }
  stream.join();
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), static_cast<std::size_t>(total));
  EXPECT_TRUE(outcomes.each_once());
  ASSERT_TRUE(inbox.wait_for_last(std::to_string(total)));

  std::set<std::string> seen;
  std::vector<int> firsts;
  for (const auto& received : inbox.all()) {
    if (seen.insert(received.body).second) {
      firsts.push_back(std::stoi(received.body));
    } else {
      EXPECT_TRUE(received.redelivered) << "a second " << received.body << " that is not flagged";
    }
  }
  EXPECT_EQ(firsts.size(), static_cast<std::size_t>(total));
  EXPECT_TRUE(std::is_sorted(firsts.begin(), firsts.end())) << "not in order";
}

TEST_P(BrokerContract, ALateSettlementAfterTheServersDeathIsIgnored) {
  const auto broker = this->broker();
  const Topic topic = this->topic(true);
  Holder holder;
  SubscriptionOptions options;
  options.group = "readers";
  const auto subscription = broker->subscribe(topic, options, holder.handler());
  await_active(*subscription);
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(holder.wait_for(1));
  ASSERT_TRUE(publisher->drain(patience));
  { const Outage outage(server()); }
  await_active(*subscription);
  ASSERT_TRUE(holder.wait_for(2)) << "unsettled, so it comes again";
  EXPECT_EQ(holder.body(1), "1");
  holder.settle(0, Settlement::accept);
  publisher->publish(text_message("2"));
  std::size_t here = 1;
  for (; holder.body(here) == "1"; ++here) {  // another copy for each time that the connection is lost on its way back
    holder.settle(here, Settlement::accept);
    ASSERT_TRUE(holder.wait_for(here + 2));
  }
  EXPECT_EQ(holder.body(here), "2");
  holder.drop_all();
}

TEST_P(BrokerContract, AMessageWithAPastIsMarkedAndNoNewOneIs) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  Outcomes outcomes;
  PublisherOptions options;
  options.deadline = std::chrono::minutes(10);
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  Past past;
  past.possibly_sent = true;
  past.age = std::chrono::minutes(9);
  ASSERT_EQ(publisher->publish_again(text_message("old"), past), PublishStatus::accepted);
  ASSERT_EQ(publisher->publish(text_message("new")), PublishStatus::accepted);
  ASSERT_TRUE(inbox.wait_for(2));
  EXPECT_THAT(inbox.bodies(), testing::ElementsAre("old", "new"));
  EXPECT_TRUE(inbox.all()[0].redelivered);
  EXPECT_FALSE(inbox.all()[1].redelivered);
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 2u);
}

TEST_P(BrokerContract, TheDeadlineOfAMessageWithAPastCountsFromItsBeginning) {
  Outage outage(server());
  const auto broker = this->broker();
  Outcomes outcomes;
  PublisherOptions options;
  options.deadline = std::chrono::minutes(10);
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic(), options);
  Past past;
  past.age = std::chrono::minutes(10) - std::chrono::milliseconds(50);
  ASSERT_EQ(publisher->publish_again(text_message("old"), past), PublishStatus::accepted);
  ASSERT_TRUE(outcomes.wait_for(1));
  EXPECT_EQ(outcomes.reason(1), "deadline");
}

TEST_P(BrokerContract, KeepNewestWhileTheServerIsAway) {
  const auto broker = this->broker();
  const Topic topic = this->topic();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  await_active(*subscription);
  Outcomes outcomes;
  PublisherOptions options;
  options.when_full = WhenFull::keep_newest;
  options.capacity = 2;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic, options);
  {
    const Outage outage(server());
    ASSERT_TRUE(eventually([&] { return broker->state() == ConnectionState::connecting; }));
    for (int i = 1; i <= 50; ++i) {
      ASSERT_EQ(publisher->publish(text_message(std::to_string(i))), PublishStatus::accepted);
    }
    ASSERT_TRUE(outcomes.wait_for(48));
    EXPECT_EQ(outcomes.reason(1), "superseded");
  }
  ASSERT_TRUE(inbox.wait_for_last("50"));
  std::vector<std::string> bodies;
  for (const auto& received : inbox.all()) {
    if (!bodies.empty() && bodies.back() == received.body) {
      EXPECT_TRUE(received.redelivered) << "a reader that lost its place with the server gets it again, marked";
    } else {
      bodies.push_back(received.body);
    }
  }
  EXPECT_THAT(bodies, testing::ElementsAre("49", "50"));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_TRUE(outcomes.each_once());
}

TEST_P(BrokerContract, ALongHandlerKeepsTheConnection) {
  const auto broker = this->broker();
  const auto silence = server().process() != nullptr ? given_up_after : moment;
  const Topic topic = this->topic();
  std::atomic<int> calls{0};
  std::promise<void> leave;
  std::atomic<bool> redelivered{false};
  std::promise<void> second;
  const auto subscription = broker->subscribe(topic, {}, [&](Delivery delivery) {
    redelivered = redelivered || delivery.redelivered;
    if (++calls == 1) {
      leave.get_future().wait_for(patience);
    } else if (calls == 2) {
      second.set_value();
    }
    delivery.settle(Settlement::accept);
  });
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(eventually([&] { return calls == 1; }));
  publisher->publish(text_message("2"));
  EXPECT_FALSE(eventually([&] { return calls > 1 || !subscription->active(); }, silence));
  leave.set_value();
  ASSERT_EQ(second.get_future().wait_for(patience), std::future_status::ready);
  EXPECT_FALSE(redelivered) << "the connection was lost meanwhile";
  EXPECT_TRUE(subscription->active());
}

}  // namespace
}  // namespace iotcloud::brokers
