// Groups, partitions and offsets on a real Kafka.
#include <algorithm>
#include <array>
#include <filesystem>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <librdkafka/rdkafka.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers {
namespace {

class KafkaGroup : public testing::Test {
 protected:
  static void SetUpTestSuite() { server_ = new tests::PrivateServer("kafka.py"); }
  static void TearDownTestSuite() { delete std::exchange(server_, nullptr); }

  static std::unique_ptr<Broker> broker(int partitions = 1, std::chrono::seconds heartbeat = std::chrono::seconds(2)) {
    BrokerOptions options;
    options.urls = {server_->url()};
    options.heartbeat = heartbeat;
    options.properties["partitions"] = std::to_string(partitions);
    return make_broker(options);
  }
  static Topic topic() {
    return {"", std::string("gw.driver.") + testing::UnitTest::GetInstance()->current_test_info()->name(), false};
  }
  static SubscriptionOptions readers() {
    SubscriptionOptions options;
    options.group = std::string("readers of ") + testing::UnitTest::GetInstance()->current_test_info()->name();
    return options;
  }
  static bool becomes_active(const Subscription& subscription) {
    return eventually([&] { return subscription.active(); }, patience);
  }
  static Message from(int driver, int number) {
    Message message = text_message(std::to_string(number));
    message.driver_id = "driver " + std::to_string(driver);
    return message;
  }

  static void delete_topic(const std::string& name) {
    rd_kafka_conf_t* conf = rd_kafka_conf_new();
    const std::string address = server_->url().substr(std::string("kafka://").size());
    rd_kafka_conf_set(conf, "bootstrap.servers", address.c_str(), nullptr, 0);
    rd_kafka_t* const operating = rd_kafka_new(RD_KAFKA_PRODUCER, conf, nullptr, 0);
    rd_kafka_queue_t* const answers = rd_kafka_queue_new(operating);
    rd_kafka_DeleteTopic_t* topic = rd_kafka_DeleteTopic_new(name.c_str());
    rd_kafka_DeleteTopics(operating, &topic, 1, nullptr, answers);
    constexpr int limit_ms = std::chrono::milliseconds(patience).count();
    rd_kafka_event_t* const answer = rd_kafka_queue_poll(answers, limit_ms);
    EXPECT_EQ(rd_kafka_event_error(answer), RD_KAFKA_RESP_ERR_NO_ERROR);
    rd_kafka_event_destroy(answer);
    rd_kafka_DeleteTopic_destroy(topic);
    rd_kafka_queue_destroy(answers);
    rd_kafka_destroy(operating);
  }

  static tests::PrivateServer* server_;
};

tests::PrivateServer* KafkaGroup::server_ = nullptr;

/// The bodies of each driver's messages, each once, in the order of `all`. Of several copies, which may have come to
/// two readers at any time, at most one is not marked.
std::map<std::string, std::vector<int>> firsts_by_driver(const std::vector<Inbox::Received>& all) {
  std::map<std::string, std::vector<int>> firsts;
  std::set<std::pair<std::string, std::string>> seen, unmarked;
  for (const auto& received : all) {
    const std::pair message(received.message.driver_id, received.body);
    if (seen.insert(message).second) firsts[message.first].push_back(std::stoi(message.second));
    if (received.redelivered) continue;
    EXPECT_TRUE(unmarked.insert(message).second) << "two of " << message.first << " " << message.second << " unmarked";
  }
  return firsts;
}

/// How many different messages the two have together.
std::size_t count_firsts(const Inbox& one, const Inbox& other) {
  auto all = one.all();
  const auto more = other.all();
  all.insert(all.end(), more.begin(), more.end());
  std::size_t count = 0;
  for (const auto& [driver, numbers] : firsts_by_driver(all)) count += numbers.size();
  return count;
}

TEST_F(KafkaGroup, KeepsTheOrderOfEachDriverOverManyPartitions) {
  const auto broker = this->broker(5);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  PublisherOptions options;
  options.capacity = 10'000;
  const auto publisher = broker->publisher(topic(), options);
  for (int number = 0; number < 200; ++number) {
    for (int driver = 0; driver < 10; ++driver) publisher->publish(from(driver, number));
  }
  ASSERT_TRUE(inbox.wait_for(2000));
  const auto firsts = firsts_by_driver(inbox.all());
  EXPECT_EQ(firsts.size(), 10U);
  for (const auto& [driver, numbers] : firsts) {
    EXPECT_EQ(numbers.size(), 200U);
    EXPECT_TRUE(std::is_sorted(numbers.begin(), numbers.end())) << driver;
  }
}

TEST_F(KafkaGroup, PartitionsMoveToAReaderThatComesAndBackWhenItGoes) {
  const auto one = this->broker(4);
  const auto other = this->broker(4);
  Inbox inbox;  // of both readers
  Inbox late;
  const auto first = one->subscribe(topic(), readers(), inbox.handler());
  ASSERT_TRUE(becomes_active(*first));
  PublisherOptions options;
  options.capacity = 10'000;
  const auto publisher = one->publisher(topic(), options);
  int number = 0;
  const auto publish_some = [&] {
    for (int i = 0; i < 100; ++i, ++number) {
      for (int driver = 0; driver < 8; ++driver) publisher->publish(from(driver, number));
    }
  };
  publish_some();
  auto second = other->subscribe(topic(), readers(), late.handler());
  ASSERT_TRUE(becomes_active(*second));
  EXPECT_TRUE(becomes_active(*first)) << "it keeps half of them";
  publish_some();
  ASSERT_TRUE(publisher->drain(patience));
  // Messages of a partition that moves may come twice, so only distinct ones count.
  const auto have_come = [&](std::size_t count) {
    return eventually([&] { return inbox.size() + late.size() >= count && count_firsts(inbox, late) == count; },
                      patience);
  };
  ASSERT_TRUE(have_come(1600));
  EXPECT_GT(late.size(), 0U);
  second.reset();
  publish_some();
  EXPECT_TRUE(have_come(2400));
}

TEST_F(KafkaGroup, LetsAMemberGoWhileItIsStillToldOfTopics) {
  constexpr std::size_t topics = 4;
  Inbox inbox;
  for (std::size_t round = 0; round < 3 * topics; ++round) {
    auto goes = this->broker();
    std::vector<std::unique_ptr<Subscription>> all;
    for (std::size_t number = 0; number < topics; ++number) {
      Topic another = topic();
      another.name += std::to_string(number);
      all.push_back(goes->subscribe(another, readers(), inbox.handler()));
    }
    // The group changes for each topic that it learns of; a member leaves amid that, at different moments.
    ASSERT_TRUE(becomes_active(*all[round % topics]));
    const auto gone = std::async(std::launch::async, [&] {
      all.clear();
      goes.reset();
    });
    ASSERT_EQ(gone.wait_for(patience), std::future_status::ready) << "it does not come back from its group";
  }
}

TEST_F(KafkaGroup, ReadsEveryTopicThatItIsToldOfWhileItChanges) {
  constexpr std::size_t topics = 6;
  Inbox inbox;
  for (int round = 0; round < 5; ++round) {
    const auto broker = this->broker();
    std::vector<std::unique_ptr<Subscription>> all;
    for (std::size_t number = 0; number < topics; ++number) {
      Topic another = topic();
      another.name += std::to_string(number);
      all.push_back(broker->subscribe(another, readers(), inbox.handler()));
      // One by one and several at a time: so the group learns of a topic during a change, and between two.
      if (number % 3 == 2) {
        ASSERT_TRUE(becomes_active(*all[number - 1]));
      }
    }
    for (const auto& subscription : all) ASSERT_TRUE(becomes_active(*subscription)) << "in round " << round;
  }
}

TEST_F(KafkaGroup, AMemberHasAllPartitionsOfATopicThatItAloneReadsWhateverItsGroupReadsElse) {
  const auto one = this->broker(4);
  const auto other = this->broker(4);
  const Topic its_own = topic();
  Topic of_the_other = topic();
  of_the_other.name += ".other";
  Inbox inbox;
  Inbox others;
  const auto first = one->subscribe(its_own, readers(), inbox.handler());
  const auto second = other->subscribe(of_the_other, readers(), others.handler());
  ASSERT_TRUE(becomes_active(*first));
  ASSERT_TRUE(becomes_active(*second));
  const auto publisher = one->publisher(its_own, {});
  for (int driver = 0; driver < 40; ++driver) publisher->publish(from(driver, 1));
  ASSERT_TRUE(inbox.wait_for(40));
  EXPECT_EQ(others.size(), 0U);
}

TEST_F(KafkaGroup, LetsAMemberGoWhoseTopicIsDeleted) {
  for (int round = 0; round < 3; ++round) {
    Topic another = topic();
    another.name += std::to_string(round);
    const auto other = this->broker();
    Inbox others;
    const auto stays = other->subscribe(topic(), readers(), others.handler());
    auto goes = this->broker();
    Inbox inbox;
    auto subscription = goes->subscribe(another, readers(), inbox.handler());
    ASSERT_TRUE(becomes_active(*stays));
    ASSERT_TRUE(becomes_active(*subscription));
    delete_topic(another.name);
    // Its partition is lost; the topic is made again, and read again.
    const auto publisher = other->publisher(another, {});
    ASSERT_TRUE(eventually(
        [&] {
          publisher->publish(text_message("x"));
          return publisher->drain(patience) && inbox.size() > 0;
        },
        patience));
    delete_topic(another.name);
    const auto gone = std::async(std::launch::async, [&] {
      subscription.reset();
      goes.reset();
    });
    ASSERT_EQ(gone.wait_for(patience), std::future_status::ready) << "it does not come back from its group";
  }
}

TEST_F(KafkaGroup, TellsIntoHowManyPartitionsATopicIsSplitAndEachHasOneReaderThatChoseIt) {
  constexpr int partitions = 3, drivers = 30;
  // A reader that gets no CPU for so long loses its partition, and what it has read is read again.
  constexpr std::chrono::seconds heartbeat(8);
  const auto one = this->broker(partitions, heartbeat);
  const auto other = this->broker(partitions, heartbeat);
  std::promise<int> told;
  const auto watch = one->watch_partitions(topic(), [&](int count) { told.set_value(count); });
  ASSERT_NE(watch, nullptr);
  const auto publisher = one->publisher(topic(), {});
  for (int driver = 0; driver < drivers; ++driver) publisher->publish(from(driver, 1));
  ASSERT_TRUE(publisher->drain(patience));
  auto count = told.get_future();
  ASSERT_EQ(count.wait_for(patience), std::future_status::ready);
  EXPECT_EQ(count.get(), partitions);

  std::array<Inbox, partitions> inboxes;
  std::vector<std::unique_ptr<Subscription>> all;
  for (int partition = 0; partition < partitions; ++partition) {
    SubscriptionOptions options = readers();
    options.partition = partition;
    Broker& broker = partition == 1 ? *other : *one;
    all.push_back(broker.subscribe(topic(), options, inboxes.at(static_cast<std::size_t>(partition)).handler()));
  }
  const auto sum = [&] { return inboxes[0].size() + inboxes[1].size() + inboxes[2].size(); };
  ASSERT_TRUE(eventually([&] { return sum() >= drivers; }, patience));
  EXPECT_EQ(sum(), drivers) << "nothing is read by two";
  for (const Inbox& inbox : inboxes) EXPECT_GT(inbox.size(), 0U);

  SubscriptionOptions options = readers();
  options.partition = 1;
  Inbox late;
  const auto second = one->subscribe(topic(), options, late.handler());
  EXPECT_TRUE(eventually([&] { return all[1]->active() != second->active(); }, patience)) << "one of the two has it";
  all[1].reset();
  ASSERT_TRUE(becomes_active(*second));
}

/// The machine's clock, which the test can halt, so that nobody who goes by it loses patience. Thread safe.
class HaltingClock final : public config::Clock {
 public:
  Instant now() const override {
    const std::lock_guard lock(mutex_);
    return halted_at_ ? *halted_at_ : config::system_clock().now();
  }
  std::int64_t wall_ms() const override { return config::system_clock().wall_ms(); }
  std::cv_status wait_until(config::ConditionVariable& changed, config::Mutex& mutex, Instant end) const override
      IOTCLOUD_REQUIRES(mutex) {
    if (now() < end) changed.wait_for(mutex, std::chrono::milliseconds(5));
    return now() < end ? std::cv_status::no_timeout : std::cv_status::timeout;
  }
  void halt() {
    const std::lock_guard lock(mutex_);
    halted_at_ = config::system_clock().now();
  }
  void go_on() {
    const std::lock_guard lock(mutex_);
    halted_at_.reset();
  }

 private:
  mutable std::mutex mutex_;
  std::optional<Instant> halted_at_;  ///< guarded by mutex_
};

/// When handlers began and ended to work on messages. Thread safe.
class Work {
 public:
  using Item = std::pair<std::string, std::string>;  ///< driver and body
  void begin(const Item& item) {
    const std::lock_guard lock(mutex_);
    ++begun_[item];
    for (const Item& other : at_work_) {
      if (other.first == item.first) overlaps_.push_back(item.first);
    }
    at_work_.push_back(item);
    if (item.second == "2" && !ended_.contains({item.first, "1"})) overlaps_.push_back(item.first);
  }
  void end(const Item& item) {
    const std::lock_guard lock(mutex_);
    at_work_.erase(std::find(at_work_.begin(), at_work_.end(), item));
    ended_.insert(item);
  }
  std::size_t ended() const {
    const std::lock_guard lock(mutex_);
    return ended_.size();
  }
  std::map<Item, int> begun() const {
    const std::lock_guard lock(mutex_);
    return begun_;
  }
  /// Drivers whose messages two handlers worked on at the same time, or in another order than they were sent.
  std::vector<std::string> overlaps() const {
    const std::lock_guard lock(mutex_);
    return overlaps_;
  }

 private:
  mutable std::mutex mutex_;
  std::map<Item, int> begun_;
  std::set<Item> ended_;
  std::vector<Item> at_work_;
  std::vector<std::string> overlaps_;
};

TEST_F(KafkaGroup, APartitionGoesToAnotherMemberOnlyWhenItsHandlerIsDoneAndThatIsCommitted) {
  constexpr int partitions = 2, drivers = 6;
  HaltingClock clock;  // of the member that gives partitions away: it must not lose patience on a busy machine
  BrokerOptions options;
  options.urls = {server_->url()};
  constexpr std::chrono::seconds heartbeat(8);  // nor may its session end
  options.heartbeat = heartbeat;
  options.properties["partitions"] = std::to_string(partitions);
  options.clock = &clock;
  const auto one = make_broker(options);
  const auto other = this->broker(partitions, heartbeat);
  Work work;
  std::promise<void> entered, leave;
  std::once_flag first_message;
  const auto handler = [&](Delivery delivery) {
    const Work::Item item(delivery.message.driver_id, std::string(delivery.message.payload.text()));
    work.begin(item);
    std::call_once(first_message, [&] {
      entered.set_value();
      leave.get_future().wait_for(patience);
    });
    delivery.settle(Settlement::accept);
    work.end(item);
  };
  const auto first = one->subscribe(topic(), readers(), handler);
  ASSERT_TRUE(becomes_active(*first));
  const auto publisher = other->publisher(topic(), {});
  for (int number = 1; number <= 2; ++number) {
    for (int driver = 0; driver < drivers; ++driver) publisher->publish(from(driver, number));
  }
  ASSERT_EQ(entered.get_future().wait_for(patience), std::future_status::ready);
  ASSERT_TRUE(publisher->drain(patience));
  clock.halt();
  const auto second = other->subscribe(topic(), readers(), handler);
  // The first member is told to give partitions away, and its handler is still at work on a message of one.
  EXPECT_TRUE(eventually([&] { return !first->active(); }, patience));
  leave.set_value();
  EXPECT_TRUE(eventually([&] { return work.ended() > 0; }, patience));
  clock.go_on();
  ASSERT_TRUE(becomes_active(*second));
  ASSERT_TRUE(eventually([&] { return work.ended() == 2 * drivers; }, patience));
  for (const auto& [item, times] : work.begun()) EXPECT_EQ(times, 1) << item.first << ", message " << item.second;
  EXPECT_THAT(work.overlaps(), testing::IsEmpty());
}

TEST_F(KafkaGroup, AfterAnOrderlyEndNothingIsDoubted) {
  auto broker = this->broker();
  Inbox first;
  Inbox second;
  auto subscription = broker->subscribe(topic(), readers(), first.handler());
  const auto sender = this->broker();
  const auto publisher = sender->publisher(topic(), {});
  for (const auto& body : numbered(1, 10)) publisher->publish(text_message(body));
  ASSERT_TRUE(first.wait_for(10));
  subscription.reset();
  broker.reset();
  for (const auto& body : numbered(11, 20)) publisher->publish(text_message(body));
  ASSERT_TRUE(publisher->drain(patience));
  broker = this->broker();
  subscription = broker->subscribe(topic(), readers(), second.handler());
  ASSERT_TRUE(second.wait_for(10));
  EXPECT_EQ(second.bodies(), numbered(11, 20));
  for (const auto& received : second.all()) EXPECT_FALSE(received.redelivered) << received.body;
}

TEST_F(KafkaGroup, WhatAReaderThatDiedMayHaveHandedOnIsFlagged) {
  const auto broker = this->broker();
  const auto publisher = broker->publisher(topic(), {});
  for (const auto& body : numbered(1, 10)) publisher->publish(text_message(body));
  ASSERT_TRUE(publisher->drain(patience));
  {  // A reader that committed the third message and ended without leaving.
    rd_kafka_conf_t* conf = rd_kafka_conf_new();
    const std::string address = server_->url().substr(std::string("kafka://").size());
    rd_kafka_conf_set(conf, "bootstrap.servers", address.c_str(), nullptr, 0);
    rd_kafka_conf_set(conf, "group.id", readers().group.c_str(), nullptr, 0);
    rd_kafka_t* dead = rd_kafka_new(RD_KAFKA_CONSUMER, conf, nullptr, 0);
    rd_kafka_topic_partition_list_t* list = rd_kafka_topic_partition_list_new(1);
    rd_kafka_topic_partition_list_add(list, topic().name.c_str(), 0)->offset = 3;
    EXPECT_EQ(rd_kafka_commit(dead, list, 0), RD_KAFKA_RESP_ERR_NO_ERROR);
    rd_kafka_topic_partition_list_destroy(list);
    rd_kafka_destroy(dead);
  }
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), readers(), inbox.handler());
  ASSERT_TRUE(inbox.wait_for(7));
  EXPECT_EQ(inbox.bodies(), numbered(4, 10));
  for (const auto& received : inbox.all()) EXPECT_TRUE(received.redelivered) << received.body;
  publisher->publish(text_message("new"));
  ASSERT_TRUE(inbox.wait_for(8));
  EXPECT_FALSE(inbox.all().back().redelivered);
}

TEST_F(KafkaGroup, WhatIsRejectedGoesToTheTopicsOwnDeadLetters) {
  const auto broker = this->broker();
  Inbox inbox(
      [](const Inbox::Received& received) { return received.body == "2" ? Settlement::reject : Settlement::accept; });
  const auto subscription = broker->subscribe(topic(), readers(), inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  for (const auto& body : numbered(1, 3)) publisher->publish(text_message(body));
  Inbox letters;
  const auto reader = broker->subscribe({"", topic().name + ".dlq", true}, {}, letters.handler());
  ASSERT_TRUE(letters.wait_for(1));
  EXPECT_EQ(letters.bodies().front(), "2");
  EXPECT_EQ(*letters.all().front().message.properties.find("dead-letter-topic"), topic().name);
}

TEST_F(KafkaGroup, ASessionThatTheServerFindsTooShortIsMadeLonger) {
  BrokerOptions options;
  options.urls = {server_->url()};
  options.heartbeat = std::chrono::milliseconds(400);  // a session of 800 ms; this server wants a second
  const auto broker = make_broker(options);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), readers(), inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("x"));
  EXPECT_TRUE(inbox.wait_for(1));
}

TEST_F(KafkaGroup, ManyTopicsOfAGroupTakeFewThreads) {
  const auto threads = [] {
    const std::filesystem::directory_iterator tasks("/proc/self/task");
    return std::distance(begin(tasks), end(tasks));
  };
  const auto before = threads();
  const auto broker = this->broker();
  std::vector<std::unique_ptr<Inbox>> inboxes;
  std::vector<std::unique_ptr<Subscription>> subscriptions;
  std::vector<std::unique_ptr<Publisher>> publishers;
  for (int i = 0; i < 60; ++i) {
    const Topic own{"", topic().name + "." + std::to_string(i), false};
    inboxes.push_back(std::make_unique<Inbox>());
    subscriptions.push_back(broker->subscribe(own, readers(), inboxes.back()->handler()));
    publishers.push_back(broker->publisher(own, {}));
    publishers.back()->publish(text_message("x"));
  }
  for (const auto& inbox : inboxes) EXPECT_TRUE(inbox->wait_for(1));
  EXPECT_LE(threads() - before, 15);
}

TEST_F(KafkaGroup, AnUrgentChannelDoesNotWaitBehindALongHandler) {
  const auto broker = this->broker();
  std::promise<void> entered;
  std::promise<void> leave;
  const auto bulk = broker->subscribe(topic(), readers(), [&](Delivery delivery) {
    entered.set_value();
    leave.get_future().wait_for(patience);
    delivery.settle(Settlement::accept);
  });
  Inbox commands;
  SubscriptionOptions urgent = readers();
  urgent.priority = urgent_priority;
  const Topic control{"", topic().name + ".control", false};
  const auto subscription = broker->subscribe(control, urgent, commands.handler());
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("bulk"));
  ASSERT_EQ(entered.get_future().wait_for(patience), std::future_status::ready);
  PublisherOptions options;
  options.priority = urgent_priority;
  const auto sender = broker->publisher(control, options);
  sender->publish(text_message("stop"));
  EXPECT_TRUE(commands.wait_for(1));
  leave.set_value();
}

}  // namespace
}  // namespace iotcloud::brokers
