// Faults that only librdkafka's mock cluster makes on demand.
#include <atomic>
#include <chrono>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <librdkafka/rdkafka.h>
#include <librdkafka/rdkafka_mock.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include <iotcloud/brokers/kafka/first_messages.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers {
namespace {

// Requests of Kafka's protocol.
constexpr std::int16_t produce_request = 0;
constexpr std::int16_t commit_request = 8;
constexpr std::int16_t producer_id_request = 22;

constexpr int nodes = 3;

class KafkaFault : public testing::Test {
 protected:
  KafkaFault() {
    rd_kafka_conf_t* conf = rd_kafka_conf_new();
    rd_kafka_conf_set(conf, "log_level", "0", nullptr, 0);
    handle_ = rd_kafka_new(RD_KAFKA_PRODUCER, conf, nullptr, 0);
    cluster_ = rd_kafka_mock_cluster_new(handle_, nodes);
  }
  ~KafkaFault() override {
    rd_kafka_mock_cluster_destroy(cluster_);
    rd_kafka_destroy(handle_);
  }
  KafkaFault(const KafkaFault&) = delete;
  KafkaFault& operator=(const KafkaFault&) = delete;

  /// \param rpc_timeout also how long each first message of a topic takes: the mock cluster never answers a request to
  /// create topics.
  std::unique_ptr<Broker> broker(std::chrono::seconds rpc_timeout = std::chrono::seconds(2)) const {
    BrokerOptions options;
    const std::string servers = rd_kafka_mock_cluster_bootstraps(cluster_);
    for (std::size_t at = 0; at < servers.size();) {
      const std::size_t end = std::min(servers.find(',', at), servers.size());
      options.urls.push_back("kafka://" + servers.substr(at, end - at));
      at = end + 1;
    }
    options.heartbeat = std::chrono::seconds(2);
    options.rpc_timeout = rpc_timeout;
    return make_broker(options);
  }
  /// Sets the round trip of all servers.
  void set_round_trip(int milliseconds) const {
    for (int node = 1; node <= nodes; ++node) rd_kafka_mock_broker_set_rtt(cluster_, node, milliseconds);
  }
  Topic topic() const { return {"", "topic", false}; }
  void fail_next(std::int16_t request, std::vector<rd_kafka_resp_err_t> errors) const {
    rd_kafka_mock_push_request_errors_array(cluster_, request, errors.size(), errors.data());
  }
  void all_down() const {
    for (int node = 1; node <= nodes; ++node) rd_kafka_mock_broker_set_down(cluster_, node);
  }
  void all_up() const {
    for (int node = 1; node <= nodes; ++node) rd_kafka_mock_broker_set_up(cluster_, node);
  }
  rd_kafka_mock_cluster_t* cluster() const { return cluster_; }

 private:
  rd_kafka_t* handle_;
  rd_kafka_mock_cluster_t* cluster_;
};

/// A reader of a topic, and a publisher with the outcomes of its messages.
struct Traffic {
  Traffic(Broker& broker, const Topic& topic)
      : subscription(broker.subscribe(topic, {}, inbox.handler())), publisher(broker.publisher(topic, [this] {
          PublisherOptions options;
          options.on_outcome = outcomes.callback();
          return options;
        }())) {}
  Inbox inbox;
  Outcomes outcomes;
  const std::unique_ptr<Subscription> subscription;
  const std::unique_ptr<Publisher> publisher;
};

TEST_F(KafkaFault, ErrorsThatPassAreNotSeenAndNothingIsLost) {
  const auto broker = this->broker();
  Traffic traffic(*broker, topic());
  traffic.publisher->publish(text_message("0"));
  ASSERT_TRUE(traffic.publisher->drain(patience));
  fail_next(produce_request, {RD_KAFKA_RESP_ERR_NOT_LEADER_FOR_PARTITION, RD_KAFKA_RESP_ERR_REQUEST_TIMED_OUT,
                              RD_KAFKA_RESP_ERR_NOT_ENOUGH_REPLICAS, RD_KAFKA_RESP_ERR__TRANSPORT});
  for (const auto& body : numbered(1, 200)) traffic.publisher->publish(text_message(body));
  ASSERT_TRUE(traffic.publisher->drain(patience));
  EXPECT_EQ(traffic.outcomes.count(Outcome::confirmed), 201U);
  // In any order, and some of them twice: the mock cluster ignores the sequence numbers by which a real one refuses
  // messages that come too early (the contract and the ledgers test real ones).
  std::set<std::string> arrived;
  ASSERT_TRUE(traffic.inbox.wait_until([&](const auto& received) {
    for (const auto& one : received) arrived.insert(one.body);
    return arrived.size() >= 201;
  }));
  EXPECT_THAT(arrived, testing::UnorderedElementsAreArray(numbered(0, 200)));
}

TEST_F(KafkaFault, WhatTheLibraryHasWhenItBecomesVoidIsNotSentAnyMore) {
  const auto broker = this->broker();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  std::atomic<config::Clock::Instant> void_before{config::Clock::Instant::min()};
  PublisherOptions options;
  Outcomes outcomes;
  options.on_outcome = outcomes.callback();
  options.void_before = [&] { return void_before.load(); };
  const auto publisher = broker->publisher(topic(), options);
  publisher->publish(text_message("before"));
  ASSERT_TRUE(publisher->drain(patience));
  fail_next(produce_request, std::vector<rd_kafka_resp_err_t>(10'000, RD_KAFKA_RESP_ERR_NOT_ENOUGH_REPLICAS));
  publisher->publish(text_message("void"));
  EXPECT_FALSE(publisher->drain(moment)) << "the library has it, and tries it again and again";
  void_before = config::system_clock().now();
  publisher->publish(text_message("after"));
  EXPECT_TRUE(outcomes.wait_for(2)) << "it is given up while no server takes anything";
  rd_kafka_mock_clear_request_errors(cluster(), produce_request);
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.of(2), Outcome::dropped);
  EXPECT_EQ(outcomes.reason(2), "fenced");
  EXPECT_EQ(outcomes.of(3), Outcome::confirmed);
  ASSERT_TRUE(inbox.wait_for_last("after"));
  EXPECT_EQ(firsts(inbox), (std::vector<std::string>{"before", "after"}));
}

/// Publishes "1..." and "2". The first one is so large that each gets a request of its own, and both requests are under
/// way when the server refuses the first and takes the second. A real server does so if it does not know the producer
/// in that partition.
void publish_two(Publisher& publisher, const std::string& driver) {
  for (const auto& body : {std::string(1'100'000, '1'), std::string("2")}) {
    Message message = text_message(body);
    message.driver_id = driver;
    publisher.publish(std::move(message));
  }
}

/// The first letters of this driver's messages, with "again" for those that may be second copies.
std::vector<std::string> arrivals(const Inbox& inbox, const std::string& driver) {
  std::vector<std::string> arrived;
  for (const auto& [body, message, redelivered] : inbox.all()) {
    if (message.driver_id == driver) arrived.push_back(body.substr(0, 1) + (redelivered ? " again" : ""));
  }
  return arrived;
}

TEST_F(KafkaFault, ThatStrikesAProducersFirstMessageInAPartitionLosesNothingAndKeepsTheOrder) {
  constexpr int partitions = 2;
  std::vector<std::string> arrived;
  const auto partition_of = [](const std::string& driver) {
    return rd_kafka_msg_partitioner_murmur2(nullptr, driver.data(), driver.size(), partitions, nullptr, nullptr);
  };
  const Message before = text_message("0");
  std::string driver = "d";
  while (partition_of(driver) == partition_of(before.driver_id)) driver += "d";
  // On a busy machine the first message's answer may come when the second one is no longer held back: then once more.
  std::chrono::steady_clock::duration took{};
  int attempt = 0;
  do {
    ASSERT_LT(++attempt, 20);
    set_round_trip(0);
    const Topic topic{"", "topic" + std::to_string(attempt), false};
    rd_kafka_mock_topic_create(cluster(), topic.name.c_str(), partitions, nodes);
    const auto broker = this->broker(std::chrono::seconds(8));
    Traffic traffic(*broker, topic);
    traffic.publisher->publish(before);
    ASSERT_TRUE(traffic.publisher->drain(patience));
    set_round_trip(100);
    fail_next(produce_request, {RD_KAFKA_RESP_ERR_NOT_LEADER_FOR_PARTITION});
    const auto begun = std::chrono::steady_clock::now();
    publish_two(*traffic.publisher, driver);
    ASSERT_TRUE(traffic.publisher->drain(patience));
    took = std::chrono::steady_clock::now() - begun;
    ASSERT_TRUE(traffic.inbox.wait_for(3));
    arrived = arrivals(traffic.inbox, driver);
  } while (took >= kafka::FirstMessages::longest_wait);
  EXPECT_THAT(arrived, testing::ElementsAre("1", "2"));
}

TEST_F(KafkaFault, WhatTheLibraryOnlyTakesForStoredIsSentAgainAndMarked) {
  std::vector<std::string> arrived;
  // On a busy machine a round trip may be over before the second request is under way: then all arrive in order.
  for (int round_trip = 100; arrived.size() != 3 || arrived[1].front() == '1'; round_trip *= 2) {
    ASSERT_LT(round_trip, 4000) << testing::PrintToString(arrived);
    set_round_trip(0);
    const Topic topic{"", "topic" + std::to_string(round_trip), false};
    const auto broker = this->broker(std::chrono::seconds(5));
    Traffic traffic(*broker, topic);
    const Message before = text_message("0");
    traffic.publisher->publish(before);
    ASSERT_TRUE(traffic.publisher->drain(patience));
    set_round_trip(round_trip);
    fail_next(produce_request, {RD_KAFKA_RESP_ERR_NOT_LEADER_FOR_PARTITION});
    publish_two(*traffic.publisher, before.driver_id);
    ASSERT_TRUE(traffic.publisher->drain(patience));
    EXPECT_TRUE(traffic.outcomes.each_once());
    ASSERT_TRUE(traffic.inbox.wait_for(3));
    arrived = arrivals(traffic.inbox, before.driver_id);
  }
  EXPECT_THAT(arrived, testing::ElementsAre("0", "2", "1 again"));
}

TEST_F(KafkaFault, WhatTheServerRefusesIsReportedAndTheRestGoesOn) {
  const auto broker = this->broker();
  PublisherOptions options;
  Outcomes outcomes;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic(), options);
  publisher->publish(text_message("good"));
  ASSERT_TRUE(publisher->drain(patience));
  fail_next(produce_request, {RD_KAFKA_RESP_ERR_INVALID_RECORD});
  publisher->publish(text_message("bad"));
  ASSERT_TRUE(publisher->drain(patience));
  publisher->publish(text_message("good again"));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.of(1), Outcome::confirmed);
  EXPECT_EQ(outcomes.of(2), Outcome::refused);
  EXPECT_EQ(outcomes.of(3), Outcome::confirmed);
}

TEST_F(KafkaFault, WhatIsRefusedInCompanyIsSentAgainAlone) {
  for (const auto error : {RD_KAFKA_RESP_ERR_MSG_SIZE_TOO_LARGE, RD_KAFKA_RESP_ERR_RECORD_LIST_TOO_LARGE,
                           RD_KAFKA_RESP_ERR_INVALID_RECORD}) {
    const auto broker = this->broker();
    const Topic topic{"", std::string("topic") + rd_kafka_err2name(error), false};
    Traffic traffic(*broker, topic);
    traffic.publisher->publish(text_message("0"));
    ASSERT_TRUE(traffic.publisher->drain(patience));
    set_round_trip(100);
    // On a busy machine the first message may go alone, and is rightly refused.
    std::size_t sent = 1, alone = 0;
    do {
      ASSERT_LT(alone, 20U);
      fail_next(produce_request, {error});
      for (const auto& body : numbered(1, 20)) traffic.publisher->publish(text_message(body));
      ASSERT_TRUE(traffic.publisher->drain(patience));
      sent += 20;
      ASSERT_THAT(traffic.outcomes.count(Outcome::refused), testing::AnyOf(alone, alone + 1));
    } while (std::exchange(alone, traffic.outcomes.count(Outcome::refused)) !=
             traffic.outcomes.count(Outcome::refused));
    set_round_trip(0);
    EXPECT_EQ(traffic.outcomes.count(Outcome::confirmed), sent - alone);
    EXPECT_TRUE(traffic.outcomes.each_once());
    ASSERT_TRUE(traffic.inbox.wait_for(sent - alone));
  }
}

TEST_F(KafkaFault, WhatIsRefusedForAReasonThatMayPassIsKeptAndTriedAgain) {
  const auto broker = this->broker();
  PublisherOptions options;
  Outcomes outcomes;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic(), options);
  publisher->publish(text_message("good"));
  ASSERT_TRUE(publisher->drain(patience));
  fail_next(produce_request,
            {RD_KAFKA_RESP_ERR_TOPIC_AUTHORIZATION_FAILED, RD_KAFKA_RESP_ERR_CLUSTER_AUTHORIZATION_FAILED,
             RD_KAFKA_RESP_ERR_POLICY_VIOLATION, RD_KAFKA_RESP_ERR_INVALID_TIMESTAMP, RD_KAFKA_RESP_ERR_INVALID_MSG});
  publisher->publish(text_message("refused five times"));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.of(2), Outcome::confirmed);
}

TEST_F(KafkaFault, AProducerThatCannotGoOnIsReplacedAndNothingIsLost) {
  // Fatal to the library, several times.
  fail_next(producer_id_request, std::vector(5, RD_KAFKA_RESP_ERR_CLUSTER_AUTHORIZATION_FAILED));
  const auto broker = this->broker();
  PublisherOptions options;
  Outcomes outcomes;
  options.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic(), options);
  for (const auto& body : numbered(1, 20)) publisher->publish(text_message(body));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 20U);
  EXPECT_TRUE(outcomes.each_once());
}

TEST_F(KafkaFault, WaitsForAClusterThatIsAway) {
  const auto broker = this->broker();
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(publisher->drain(patience));
  all_down();
  ASSERT_TRUE(eventually([&] { return broker->state() == ConnectionState::connecting; }, patience));
  publisher->publish(text_message("2"));
  EXPECT_FALSE(publisher->drain(moment));
  all_up();
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_EQ(broker->state(), ConnectionState::connected);
}

TEST_F(KafkaFault, OneServerOfSeveralMayDie) {
  rd_kafka_mock_topic_create(cluster(), "topic", 1, nodes);
  rd_kafka_mock_partition_set_leader(cluster(), "topic", 0, 1);
  const auto broker = this->broker();
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(publisher->drain(patience));
  rd_kafka_mock_broker_set_down(cluster(), 1);
  rd_kafka_mock_partition_set_leader(cluster(), "topic", 0, 2);
  publisher->publish(text_message("2"));
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_TRUE(eventually([&] { return broker->state() == ConnectionState::connected; }, patience));
}

TEST_F(KafkaFault, ASlowServerIsWaitedForAndNothingIsSentTwice) {
  const auto broker = this->broker(std::chrono::seconds(8));  // a busy machine is slower than the server
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }, patience));
  set_round_trip(200);
  const auto publisher = broker->publisher(topic(), {});
  for (const auto& body : numbered(1, 50)) publisher->publish(text_message(body));
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(inbox.wait_for(50));
  EXPECT_EQ(inbox.bodies(), numbered(1, 50));
}

TEST_F(KafkaFault, ServersMayBeFarAway) {
  set_round_trip(250);
  const auto broker = this->broker();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("1"));
  EXPECT_TRUE(publisher->drain(patience));
  EXPECT_TRUE(inbox.wait_for(1));
  EXPECT_EQ(broker->state(), ConnectionState::connected);
}

TEST_F(KafkaFault, WhatIsInHandIsNotTakenBackWhileServersAreSlowToAnswer) {
  rd_kafka_mock_topic_create(cluster(), "topic", 1, nodes);
  rd_kafka_mock_partition_set_leader(cluster(), "topic", 0, 2);
  rd_kafka_mock_coordinator_set(cluster(), "group", "topic", 2);
  const auto broker = this->broker();
  Holder holder;
  const auto subscription = broker->subscribe(topic(), {}, holder.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }, patience));
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(holder.wait_for(1));
  set_round_trip(250);
  rd_kafka_mock_broker_set_down(cluster(), 1);
  for (std::size_t i = 2; i <= 6; ++i) {
    publisher->publish(text_message(std::to_string(i)));
    ASSERT_TRUE(holder.wait_for(i));
    EXPECT_EQ(holder.body(i - 1), std::to_string(i));
  }
  EXPECT_EQ(broker->state(), ConnectionState::connected);
  holder.drop_all();
}

TEST_F(KafkaFault, ACommitThatFailsIsTriedAgain) {
  const auto broker = this->broker();
  Inbox first;
  Inbox second;
  auto subscription = broker->subscribe(topic(), {}, first.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }, patience));
  const auto publisher = broker->publisher(topic(), {});
  fail_next(commit_request, {RD_KAFKA_RESP_ERR_REBALANCE_IN_PROGRESS, RD_KAFKA_RESP_ERR_UNKNOWN});
  for (const auto& body : numbered(1, 5)) publisher->publish(text_message(body));
  ASSERT_TRUE(first.wait_for(5));
  subscription.reset();
  subscription = broker->subscribe(topic(), {}, second.handler());
  ASSERT_TRUE(eventually([&] { return subscription->active(); }, patience));
  publisher->publish(text_message("6"));
  ASSERT_TRUE(second.wait_for_last("6"));
  for (const auto& received : second.all()) EXPECT_TRUE(received.body == "6" || received.redelivered);
}

}  // namespace
}  // namespace iotcloud::brokers
