// What becomes of messages whose tuples fail, or whose commands may not have arrived, on each kind of broker.
#include <algorithm>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/tests/servers/private_server.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>

namespace iotcloud::topology {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;

/// Fails the texts that it is told to fail, and counts what it sees.
class PickyBolt final : public Bolt {
 public:
  static void reset() {
    const std::lock_guard lock(mutex_);
    poison_.clear();
    unlucky_.clear();
    seen_.clear();
  }
  static void poison(const std::string& text) {
    const std::lock_guard lock(mutex_);
    poison_.insert(text);
  }
  /// Messages with this text fail, but not because of themselves.
  static void make_unlucky(const std::string& text) {
    const std::lock_guard lock(mutex_);
    unlucky_.insert(text);
  }
  static void heal() {
    const std::lock_guard lock(mutex_);
    poison_.clear();
    unlucky_.clear();
  }
  static int seen(const std::string& text) {
    const std::lock_guard lock(mutex_);
    return seen_[text];
  }

  void declare_output_fields(OutputFieldsDeclarer& declarer) const override {
    declarer.declare(Fields{"text", "driverID", "time"});
  }
  void prepare(const Config&, const TopologyContext&, OutputCollector& collector) override { collector_ = &collector; }
  void execute(const Tuple& tuple) override {
    const auto& text = tuple.get<std::string>("text");
    {
      const std::lock_guard lock(mutex_);
      ++seen_[text];
      if (poison_.contains(text)) throw std::runtime_error("poison");
      if (unlucky_.contains(text)) return collector_->retry(tuple);
    }
    collector_->emit(tuple, Values(text, tuple.at("driverID"), tuple.at("time")));
    collector_->ack(tuple);
  }

 private:
  static inline std::mutex mutex_;
  static inline std::set<std::string> poison_, unlucky_;  ///< guarded by mutex_
  static inline std::map<std::string, int> seen_;         ///< guarded by mutex_
  OutputCollector* collector_ = nullptr;
};

/// One server for all tests of this process; each test has topics of its own.
std::string broker_url(const std::string& kind) {
  if (kind == "embedded") return "";
  static tests::PrivateServer rabbitmq("rabbitmq.py");
  return rabbitmq.url();
}

class FailedMessages : public Endpoints, public testing::WithParamInterface<std::string> {
 protected:
  FailedMessages() : Endpoints(broker_url(GetParam())) { PickyBolt::reset(); }

  Worker& run_picky(const std::string& properties) {
    ComponentRegistry components;
    components.add_bolt<PickyBolt>("Picky");
    return run_yaml(
        "topology.name: t\nspouts:\n  in:\n    broker: rabbitmq\n    driver: d\n    channel: up\n"
        "    fields: [text, driverID, time]\n    builder: text\n    properties: " +
            properties +
            "\nbolts:\n  picky: {class: Picky, inputs: {from: in}}\n"
            "  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, driverID, time], "
            "inputs: {from: picky}}\n",
        std::move(components));
  }
  /// A name for a driver or topic that no other test has.
  std::string unique(const std::string& name) const { return name + url_.substr(url_.rfind('-')); }
  std::size_t pending() const {
    std::size_t tuples = 0;
    for (const TaskSnapshot& task : workers_.back()->snapshot().tasks) tuples += task.pending;
    return tuples;
  }
  /// Ends the worker and starts another one: the broker delivers what was not settled.
  void start_again(const std::string& properties) {
    workers_.back()->stop(tests::patience);
    workers_.clear();
    run_picky(properties);
  }
};

INSTANTIATE_TEST_SUITE_P(On, FailedMessages, testing::Values("embedded", "rabbitmq"),
                         [](const auto& kind) { return kind.param; });

TEST_P(FailedMessages, GoToTheDeadLetterTopicAndWaitThereForAReader) {
  const std::string driver = unique("one"), letters = unique("letters");
  const std::string properties = "{deadLetter: " + letters + "}";
  Mailbox mailbox(*broker_, topic(driver, "down"));
  PickyBolt::poison("bad");
  run_picky(properties);
  show_driver(driver);
  const auto publisher = device(driver);
  brokers::Message bad = message("bad", driver, 1234);
  bad.properties.set("colour", "red");
  publisher->publish(bad);
  publisher->publish(message("good", driver));
  ASSERT_TRUE(mailbox.wait_for(1));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_dead_letters_total") == 1; }));
  EXPECT_EQ(metric("iotcloud_spout_retried_total"), 2);
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 0);
  EXPECT_EQ(PickyBolt::seen("bad"), 3);

  Mailbox reader(*broker_, letters, true);
  ASSERT_TRUE(reader.wait_for(1));
  const brokers::Message letter = reader.message(0);
  EXPECT_EQ(letter.payload.text(), "bad");
  EXPECT_EQ(letter.driver_id, driver);
  EXPECT_EQ(letter.time_ms, 1234);
  const std::map<std::string, std::string> properties_of_letter(letter.properties.begin(), letter.properties.end());
  EXPECT_THAT(properties_of_letter,
              ElementsAre(std::pair("colour", "red"), std::pair("dead-letter-component", "in"),
                          std::pair("dead-letter-reason", "the tuple failed or timed out"),
                          std::pair("dead-letter-topic", topic(driver, "up")), std::pair("dead-letter-topology", "t"),
                          std::pair("dead-letter-tries", "3")));

  start_again(properties);  // the original was accepted, so that it does not come back
  publisher->publish(message("after", driver));
  ASSERT_TRUE(mailbox.wait_for(2));
  EXPECT_THAT(mailbox.texts(), ElementsAre("good", "after"));
  EXPECT_EQ(PickyBolt::seen("bad"), 3);
  EXPECT_THAT(reader.texts(), SizeIs(1));
}

TEST_P(FailedMessages, AreRejectedAndCountedWithoutADeadLetterTopic) {
  const std::string driver = unique("one");
  Mailbox mailbox(*broker_, topic(driver, "down"));
  PickyBolt::poison("bad");
  run_picky("{maxTries: 2}");
  show_driver(driver);
  const auto publisher = device(driver);
  publisher->publish(message("bad", driver));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_rejected_total") == 1; }));
  EXPECT_EQ(metric("iotcloud_spout_retried_total"), 1);
  EXPECT_EQ(metric("iotcloud_spout_dead_letters_total"), 0);

  start_again("{maxTries: 2}");
  publisher->publish(message("after", driver));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_THAT(mailbox.texts(), ElementsAre("after"));
  EXPECT_EQ(PickyBolt::seen("bad"), 2);
}

TEST_P(FailedMessages, AreNotGivenUpForTriesThatABoltDoesNotBlameOnThem) {
  const std::string driver = unique("one");
  Mailbox mailbox(*broker_, topic(driver, "down"));
  PickyBolt::make_unlucky("unlucky");
  run_picky("{maxTries: 2, requeue: false}");
  show_driver(driver);
  const auto publisher = device(driver);
  publisher->publish(message("unlucky", driver));
  ASSERT_TRUE(eventually([&] { return PickyBolt::seen("unlucky") >= 4; }));
  PickyBolt::heal();
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 0);
}

TEST_P(FailedMessages, AreTriedAgainUntilTheySucceedBeforeWhatTheirDriverSentBehindThem) {
  const std::string one = unique("one"), two = unique("two");
  Mailbox from_one(*broker_, topic(one, "down")), from_two(*broker_, topic(two, "down"));
  PickyBolt::poison("first");
  run_picky("{maxTries: 1000}");
  show_driver(one);
  show_driver(two);
  const auto publisher_one = device(one), publisher_two = device(two);
  publisher_one->publish(message("first", one));
  ASSERT_TRUE(eventually([&] { return PickyBolt::seen("first") >= 2; }));
  publisher_one->publish(message("second", one));
  publisher_one->publish(message("third", one));
  publisher_two->publish(message("other", two));
  ASSERT_TRUE(from_two.wait_for(1));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_received_total") == 4; }));
  EXPECT_THAT(from_one.texts(), IsEmpty());
  PickyBolt::heal();
  ASSERT_TRUE(from_one.wait_for(3));
  EXPECT_THAT(from_one.texts(), ElementsAre("first", "second", "third"));
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 0);
}

TEST_P(FailedMessages, StayWithTheBrokerWhenTheWorkerStopsBetweenTwoTries) {
  const std::string driver = unique("one");
  Mailbox mailbox(*broker_, topic(driver, "down"));
  PickyBolt::poison("bad");
  run_picky("{maxTries: 1000}");
  show_driver(driver);
  const auto publisher = device(driver);
  publisher->publish(message("bad", driver));
  publisher->publish(message("behind", driver));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_retried_total") >= 2; }));
  workers_.back()->stop(std::chrono::seconds(5));
  workers_.clear();
  PickyBolt::heal();
  run_picky("{}");
  ASSERT_TRUE(eventually([&] {
    const auto texts = mailbox.texts();
    return std::count(texts.begin(), texts.end(), "bad") == 1 && std::count(texts.begin(), texts.end(), "behind") >= 1;
  }));
}

TEST_P(FailedMessages, AllBecomeLettersWhenThereAreMany) {
  constexpr int count = 200;
  const std::string driver = unique("one"), letters = unique("letters");
  PickyBolt::poison("bad");
  run_picky("{deadLetter: " + letters + ", maxTries: 1, prefetchCount: 10}");
  show_driver(driver);
  const auto publisher = device(driver);
  for (int i = 0; i < count; ++i) publisher->publish(message("bad", driver, i + 1));
  Mailbox reader(*broker_, letters, true);
  ASSERT_TRUE(reader.wait_for(count));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_spout_dead_letters_total") == count; }));
  std::set<std::int64_t> times;
  for (std::size_t i = 0; i < count; ++i) times.insert(reader.message(i).time_ms);
  EXPECT_THAT(times, SizeIs(count));
}

/// What a topology sends back to drivers.
class Commands : public FailedMessages {};

INSTANTIATE_TEST_SUITE_P(On, Commands, testing::Values("embedded", "rabbitmq"),
                         [](const auto& kind) { return kind.param; });

/// Nobody reads the driver's channel, so that the broker does not take the command for good.
TEST_P(Commands, ThatTheBrokerHasNotConfirmedAreMadeAgainFromTheSpoutsMessageWhenTheWorkerEnds) {
  const std::string driver = unique("one");
  run_picky("{}");
  show_driver(driver);
  const auto publisher = device(driver);
  publisher->publish(message("command", driver));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_bolt_sent_total") == 1; }));
  workers_.back()->stop(std::chrono::milliseconds(200));  // what its publisher has is lost with it
  workers_.clear();
  run_picky("{}");
  Mailbox mailbox(*broker_, topic(driver, "down"));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_EQ(mailbox.texts().at(0), "command");
}

/// Nobody reads the driver's channel meanwhile, as above.
TEST_P(Commands, OfADriverThatIsStartedAnewMoreOftenThanAMessageIsTriedAreNotGivenUp) {
  constexpr int starts = 3;
  const std::string driver = unique("one");
  run_picky("{maxTries: 2}");
  show_driver(driver);
  const auto publisher = device(driver);
  publisher->publish(message("command", driver));
  for (int start = 1; start <= starts; ++start) {
    ASSERT_TRUE(eventually([&] { return metric("iotcloud_bolt_sent_total") == start; })) << start;
    show_driver(driver, "rabbitmq", discovery::DriverState::starting);
    ASSERT_TRUE(eventually([&] { return metric("iotcloud_bolt_lost_total") == start; })) << start;
    show_driver(driver);
  }
  Mailbox mailbox(*broker_, topic(driver, "down"));
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_EQ(mailbox.texts().at(0), "command");
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 0);
}

TEST_P(Commands, ThatTheBrokerHasConfirmedSettleTheSpoutsMessages) {
  const std::string driver = unique("one");
  Mailbox mailbox(*broker_, topic(driver, "down"));
  run_picky("{}");
  show_driver(driver);
  const auto publisher = device(driver);
  for (int i = 0; i < 300; ++i) publisher->publish(message(std::to_string(i), driver));
  ASSERT_TRUE(mailbox.wait_for(300));
  ASSERT_TRUE(eventually([&] { return pending() == 0; }));
  EXPECT_EQ(metric("iotcloud_spout_retried_total"), 0);
  start_again("{}");
  publisher->publish(message("last", driver));
  ASSERT_TRUE(mailbox.wait_for(301));
  EXPECT_EQ(mailbox.texts().back(), "last");
}

/// The server goes while a tuple stands before the gate, and is away when it passes.
class BrokerThatIsAway : public Endpoints {
 protected:
  void stop_server_while_works(const std::string& text) {
    show_driver("one");
    Gate::set(false);
    publisher_ = device("one");
    publisher_->publish(message(text, "one"));
    ASSERT_TRUE(Gate::wait_for_one());
    server_.stop();
    Gate::set(true);
  }

  brokers::embedded::Server server_ = brokers::embedded::Server::named(url_.substr(11));
  std::unique_ptr<brokers::Publisher> publisher_;
};

TEST_F(BrokerThatIsAway, HasNoMessageOfTheSpoutAcknowledgedBeforeItsCommandIsSafe) {
  ComponentRegistry components;
  components.add_bolt<GateBolt>("Gate");
  Mailbox mailbox(*broker_, topic("one", "down"));
  run_yaml(
      "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, "
      "builder: text, fields: [text, driverID, time]}\n"
      "bolts:\n  gate: {class: Gate, inputs: {from: in}}\n"
      "  out: {broker: rabbitmq, driver: d, channel: down, fields: [text, driverID, time], inputs: {from: gate}}\n",
      std::move(components));
  ASSERT_NO_FATAL_FAILURE(stop_server_while_works("command"));
  ASSERT_TRUE(eventually([&] { return metric("iotcloud_bolt_sent_total") == 1; }));
  const auto pending = [&] {
    std::size_t tuples = 0;
    for (const TaskSnapshot& task : workers_.back()->snapshot().tasks) tuples += task.pending;
    return tuples;
  };
  EXPECT_EQ(pending(), 1U);
  server_.start();
  ASSERT_TRUE(mailbox.wait_for(1));
  EXPECT_TRUE(eventually([&] { return pending() == 0; }));
}

TEST_F(BrokerThatIsAway, GetsItsDeadLettersWhenItIsBack) {
  PickyBolt::reset();
  PickyBolt::poison("bad");
  ComponentRegistry components;
  components.add_bolt<PickyBolt>("Picky");
  components.add_bolt<GateBolt>("Gate");
  run_yaml(
      "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, builder: text, "
      "fields: [text, driverID, time], properties: {maxTries: 1, deadLetter: letters}}\n"
      "bolts:\n  gate: {class: Gate, inputs: {from: in}}\n  picky: {class: Picky, inputs: {from: gate}}\n",
      std::move(components));
  ASSERT_NO_FATAL_FAILURE(stop_server_while_works("bad"));
  ASSERT_TRUE(eventually([] { return PickyBolt::seen("bad") == 1; }));
  EXPECT_EQ(metric("iotcloud_spout_dead_letters_total"), 0);
  server_.start();
  Mailbox reader(*broker_, "letters", true);
  ASSERT_TRUE(reader.wait_for(1));
  EXPECT_EQ(reader.texts().at(0), "bad");
}

}  // namespace
}  // namespace iotcloud::topology
