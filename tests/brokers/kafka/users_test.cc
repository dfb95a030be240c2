// What the users of docker-compose.yml may do at Kafka, and what the thief of one gateway's user tries there.
#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <functional>
#include <initializer_list>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <librdkafka/rdkafka.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/brokers/tampering_proxy.h"
#include "iotcloud/tests/captured_log.h"
#include "iotcloud/tests/servers/free_port.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

constexpr const char* password = "sesame";  // of all users (tests/servers/kafka.py)
constexpr const char* not_for_topic = "TOPIC_AUTHORIZATION_FAILED";
constexpr const char* not_for_group = "GROUP_AUTHORIZATION_FAILED";
constexpr const char* not_for_cluster = "CLUSTER_AUTHORIZATION_FAILED";
constexpr int limit_ms = 60'000;

struct Destroy {
  void operator()(rd_kafka_t* handle) const { rd_kafka_destroy(handle); }
  void operator()(rd_kafka_topic_t* topic) const { rd_kafka_topic_destroy(topic); }
  void operator()(rd_kafka_topic_partition_list_t* list) const { rd_kafka_topic_partition_list_destroy(list); }
  void operator()(rd_kafka_message_t* message) const { rd_kafka_message_destroy(message); }
  void operator()(rd_kafka_queue_t* queue) const { rd_kafka_queue_destroy(queue); }
  void operator()(rd_kafka_event_t* event) const { rd_kafka_event_destroy(event); }
  void operator()(rd_kafka_NewTopic_t* topic) const { rd_kafka_NewTopic_destroy(topic); }
  void operator()(rd_kafka_DeleteTopic_t* topic) const { rd_kafka_DeleteTopic_destroy(topic); }
  void operator()(rd_kafka_ConfigResource_t* which) const { rd_kafka_ConfigResource_destroy(which); }
  void operator()(rd_kafka_AclBinding_t* binding) const { rd_kafka_AclBinding_destroy(binding); }
};
template <typename T>
using Owned = std::unique_ptr<T, Destroy>;

std::string text_of(rd_kafka_resp_err_t error) {
  return error == RD_KAFKA_RESP_ERR_NO_ERROR ? "ok" : rd_kafka_err2name(error);
}

/// A bare client, which may do anything that its user may. Each attempt has a client of its own.
class Attempts {
 public:
  Attempts(const std::string& url, std::string user)
      : server_(url.substr(url.find("//") + 2)), user_(std::move(user)) {}

  /// A client that sends, for send().
  Owned<rd_kafka_t> sender() const {
    return make(RD_KAFKA_PRODUCER, {{"message.timeout.ms", "60000"}, {"queue.buffering.max.messages", "50"}});
  }
  /// What the server says to each: "ok", or why not.
  static std::string send(rd_kafka_t* client, const std::string& topic) {
    std::string answer = "no answer";
    const Owned<rd_kafka_topic_t> to(rd_kafka_topic_new(client, topic.c_str(), nullptr));
    std::string body = "forged";
    if (rd_kafka_produce(to.get(), RD_KAFKA_PARTITION_UA, RD_KAFKA_MSG_F_COPY, body.data(), body.size(), nullptr, 0,
                         &answer) != 0) {
      return text_of(rd_kafka_last_error());
    }
    rd_kafka_flush(client, limit_ms);
    return answer;
  }
  std::string publish(const std::string& topic) const { return send(sender().get(), topic); }
  /// Sends with a client of sender() until the server has it wait. Whether it did.
  bool flood(rd_kafka_t* client, const std::string& topic) const {
    const Owned<rd_kafka_topic_t> to(rd_kafka_topic_new(client, topic.c_str(), nullptr));
    std::string body(100'000, 'x');
    for (int sent = 0; sent < 3000 && !held_back_; rd_kafka_poll(client, 10)) {
      if (rd_kafka_produce(to.get(), RD_KAFKA_PARTITION_UA, RD_KAFKA_MSG_F_COPY, body.data(), body.size(), nullptr, 0,
                           nullptr) == 0) {
        ++sent;
      }
    }
    return held_back_;
  }
  /// A client that reads partition 0 from its beginning, in no group that others have.
  Owned<rd_kafka_t> reader(const std::string& topic) const {
    auto client = make(RD_KAFKA_CONSUMER, {{"group.id", user_ + ".unused"}, {"enable.partition.eof", "true"}});
    const Owned<rd_kafka_topic_partition_list_t> list(rd_kafka_topic_partition_list_new(1));
    rd_kafka_topic_partition_list_add(list.get(), topic.c_str(), 0)->offset = RD_KAFKA_OFFSET_BEGINNING;
    rd_kafka_assign(client.get(), list.get());
    rd_kafka_poll_set_consumer(client.get());
    return client;
  }
  /// "ok": a message, or the end of a partition.
  static std::string news(rd_kafka_t* reader) {
    const Owned<rd_kafka_message_t> message(rd_kafka_consumer_poll(reader, limit_ms));
    if (!message) return "no answer";
    return message->err == RD_KAFKA_RESP_ERR__PARTITION_EOF ? "ok" : text_of(message->err);
  }
  std::string read(const std::string& topic) const { return news(reader(topic).get()); }
  /// Asks what partitions it has; who is not told cannot even ask for its records.
  std::string look_at(const std::string& topic) const {
    const auto client = make(RD_KAFKA_PRODUCER, {});
    const Owned<rd_kafka_topic_t> handle(rd_kafka_topic_new(client.get(), topic.c_str(), nullptr));
    const rd_kafka_metadata_t* found = nullptr;
    const auto error = rd_kafka_metadata(client.get(), 0, handle.get(), &found, limit_ms);
    if (error != RD_KAFKA_RESP_ERR_NO_ERROR) return text_of(error);
    std::string answer = found->topic_cnt == 1 ? text_of(found->topics[0].err) : "no such topic";
    rd_kafka_metadata_destroy(found);
    return answer;
  }
  std::string join(const std::string& group, const std::string& topic) const {
    const auto client = make(
        RD_KAFKA_CONSUMER, {{"group.id", group}, {"auto.offset.reset", "earliest"}, {"enable.partition.eof", "true"}});
    const Owned<rd_kafka_topic_partition_list_t> list(rd_kafka_topic_partition_list_new(1));
    rd_kafka_topic_partition_list_add(list.get(), topic.c_str(), RD_KAFKA_PARTITION_UA);
    rd_kafka_subscribe(client.get(), list.get());
    rd_kafka_poll_set_consumer(client.get());
    std::string answer = news(client.get());
    rd_kafka_consumer_close(client.get());
    return answer;
  }
  using Settings = std::initializer_list<std::pair<const char*, std::string>>;
  std::string make_topic(const std::string& name, Settings settings = {}) const {
    std::array<char, 512> problem{};
    const Owned<rd_kafka_NewTopic_t> topic(rd_kafka_NewTopic_new(name.c_str(), 1, 1, problem.data(), problem.size()));
    for (const auto& [setting, value] : settings) rd_kafka_NewTopic_set_config(topic.get(), setting, value.c_str());
    auto* const which = topic.get();
    return ask([&](rd_kafka_t* client, rd_kafka_queue_t* queue) {
      std::array topics{which};
      rd_kafka_CreateTopics(client, topics.data(), 1, nullptr, queue);
    });
  }
  std::string remove_topic(const std::string& name) const {
    const Owned<rd_kafka_DeleteTopic_t> topic(rd_kafka_DeleteTopic_new(name.c_str()));
    return ask([&](rd_kafka_t* client, rd_kafka_queue_t* queue) {
      std::array topics{topic.get()};
      rd_kafka_DeleteTopics(client, topics.data(), 1, nullptr, queue);
    });
  }
  /// Gives its own user all rights to a topic.
  std::string take_rights(const std::string& topic) const {
    std::array<char, 512> problem{};
    const Owned<rd_kafka_AclBinding_t> rule(rd_kafka_AclBinding_new(
        RD_KAFKA_RESOURCE_TOPIC, topic.c_str(), RD_KAFKA_RESOURCE_PATTERN_LITERAL, ("User:" + user_).c_str(), "*",
        RD_KAFKA_ACL_OPERATION_ALL, RD_KAFKA_ACL_PERMISSION_TYPE_ALLOW, problem.data(), problem.size()));
    return ask([&](rd_kafka_t* client, rd_kafka_queue_t* queue) {
      std::array rules{rule.get()};
      rd_kafka_CreateAcls(client, rules.data(), 1, nullptr, queue);
    });
  }

  /// A topic's settings, a line each.
  std::string settings_of(const std::string& topic) const {
    const Owned<rd_kafka_ConfigResource_t> which(rd_kafka_ConfigResource_new(RD_KAFKA_RESOURCE_TOPIC, topic.c_str()));
    return ask([&](rd_kafka_t* client, rd_kafka_queue_t* queue) {
      std::array topics{which.get()};
      rd_kafka_DescribeConfigs(client, topics.data(), 1, nullptr, queue);
    });
  }

 private:
  static void on_report(rd_kafka_t*, const rd_kafka_message_t* message, void*) {
    if (message->_private != nullptr) *static_cast<std::string*>(message->_private) = text_of(message->err);
  }
  static void on_throttle(rd_kafka_t*, const char*, std::int32_t, int ms, void* held_back) {
    if (ms > 0) *static_cast<std::atomic<bool>*>(held_back) = true;
  }
  Owned<rd_kafka_t> make(rd_kafka_type_t type, Settings more) const {
    rd_kafka_conf_t* const settings = rd_kafka_conf_new();
    std::array<char, 512> problem{};
    const auto set = [&](const char* name, const std::string& value) {
      EXPECT_EQ(rd_kafka_conf_set(settings, name, value.c_str(), problem.data(), problem.size()), RD_KAFKA_CONF_OK)
          << problem.data();
    };
    set("bootstrap.servers", server_);
    set("security.protocol", "sasl_plaintext");
    set("sasl.mechanisms", "PLAIN");
    set("sasl.username", user_);
    set("sasl.password", password);
    for (const auto& [name, value] : more) set(name, value);
    rd_kafka_conf_set_opaque(settings, &held_back_);
    rd_kafka_conf_set_throttle_cb(settings, on_throttle);
    if (type == RD_KAFKA_PRODUCER) rd_kafka_conf_set_dr_msg_cb(settings, on_report);
    return Owned<rd_kafka_t>(rd_kafka_new(type, settings, problem.data(), problem.size()));
  }
  static std::string lines_of(const rd_kafka_DescribeConfigs_result_t* settings) {
    std::size_t count = 0;
    const auto* const topic = rd_kafka_DescribeConfigs_result_resources(settings, &count)[0];
    const auto* const* const entries = rd_kafka_ConfigResource_configs(topic, &count);
    std::string lines;
    for (std::size_t i = 0; i < count; ++i) {
      const char* const value = rd_kafka_ConfigEntry_value(entries[i]);
      lines += std::string(rd_kafka_ConfigEntry_name(entries[i])) + "=" + (value == nullptr ? "" : value) + "\n";
    }
    return lines;
  }
  /// Has a request of an administrator answered.
  std::string ask(const std::function<void(rd_kafka_t*, rd_kafka_queue_t*)>& request) const {
    const auto client = make(RD_KAFKA_PRODUCER, {});
    const Owned<rd_kafka_queue_t> queue(rd_kafka_queue_new(client.get()));
    request(client.get(), queue.get());
    const Owned<rd_kafka_event_t> event(rd_kafka_queue_poll(queue.get(), limit_ms));
    if (!event) return "no answer";
    if (const auto error = rd_kafka_event_error(event.get()); error != RD_KAFKA_RESP_ERR_NO_ERROR)
      return text_of(error);
    std::size_t count = 0;
    if (const auto* made = rd_kafka_event_CreateTopics_result(event.get()))
      return text_of(rd_kafka_topic_result_error(rd_kafka_CreateTopics_result_topics(made, &count)[0]));
    if (const auto* removed = rd_kafka_event_DeleteTopics_result(event.get()))
      return text_of(rd_kafka_topic_result_error(rd_kafka_DeleteTopics_result_topics(removed, &count)[0]));
    if (const auto* settings = rd_kafka_event_DescribeConfigs_result(event.get())) return lines_of(settings);
    const auto* rules = rd_kafka_event_CreateAcls_result(event.get());
    return rules == nullptr ? "another answer"
                            : text_of(rd_kafka_error_code(
                                  rd_kafka_acl_result_error(rd_kafka_CreateAcls_result_acls(rules, &count)[0])));
  }

  const std::string server_, user_;
  mutable std::atomic<bool> held_back_ = false;  ///< the server has had a client wait, because it sent too much
};

class KafkaUsers : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    telling_port_ = tests::free_port();
    told_port_ = tests::free_port();
    server_ = new tests::PrivateServer("kafka.py", {"--users", "--partitions", "2", "--listener",
                                                    std::to_string(telling_port_) + ":" + std::to_string(told_port_)});
    std::ofstream(password_file()) << password << '\n';
  }
  static void TearDownTestSuite() { delete std::exchange(server_, nullptr); }
  static std::string password_file() { return (server_->folder() / "password").string(); }

  static BrokerOptions options_of(const std::string& user) {
    BrokerOptions options;
    options.urls = {server_->url()};
    options.user = user;
    options.password_file = password_file();
    return options;
  }
  static tests::PrivateServer* server_;
  /// Where the server tells its clients to go on at the other one.
  static int telling_port_, told_port_;
};
tests::PrivateServer* KafkaUsers::server_ = nullptr;
int KafkaUsers::telling_port_ = 0;
int KafkaUsers::told_port_ = 0;

TEST_F(KafkaUsers, GatewaysAndWorkersGetEachOthersMessages) {
  const auto gateway = make_broker(options_of("gateway-1")), workers = make_broker(options_of("workers"));
  const Topic data{"", "gateway-1.turtle.data", false}, control{"", "gateway-1.turtle.control", false};
  Inbox at_workers, at_gateway;
  const auto sends_data = gateway->publisher(data, {}), sends_control = workers->publisher(control, {});
  std::vector<std::unique_ptr<Subscription>> read;
  for (const std::int32_t partition : {0, 1}) {  // as a topology's tasks do
    SubscriptionOptions of_task;
    of_task.group = "echo";
    of_task.partition = partition;
    read.push_back(workers->subscribe(data, of_task, at_workers.handler()));
  }
  read.push_back(gateway->subscribe(control, {}, at_gateway.handler()));
  expect_arrivals(*sends_data, at_workers, 1);
  expect_arrivals(*sends_control, at_gateway, 4);
}

TEST_F(KafkaUsers, TheThiefOfAGatewayNeitherSendsAsAnotherOneNorReadsItsMessages) {
  const std::string own = "gateway-1.turtle.mine", foreign = "gateway-2.turtle.data";
  const Attempts thief(server_->url(), "gateway-1"), other(server_->url(), "gateway-2");
  EXPECT_EQ(other.publish(foreign), "ok");
  EXPECT_EQ(thief.publish(own), "ok");
  EXPECT_EQ(thief.look_at(own), "ok");
  EXPECT_EQ(thief.read(own), "ok");
  EXPECT_EQ(thief.join(own, own), "ok");

  EXPECT_EQ(thief.publish(foreign), not_for_topic);
  EXPECT_EQ(thief.look_at(foreign), not_for_topic);
  EXPECT_EQ(thief.join(own, foreign), not_for_topic);
  for (const auto& group : {"gateway-2.turtle.data", "echo", "echo#1", "gateway-1"})
    EXPECT_EQ(thief.join(group, own), not_for_group) << group;
  for (const auto& topic : {"gateway-2.new", "gateway-10.new", "gateway-1", "anything", "__consumer_offsets"})
    EXPECT_EQ(thief.publish(topic), not_for_topic) << topic;
  EXPECT_EQ(thief.make_topic("gateway-2.new"), not_for_topic);
  EXPECT_EQ(thief.remove_topic(foreign), not_for_topic);
  EXPECT_EQ(thief.take_rights(foreign), not_for_cluster);
  EXPECT_EQ(other.read(foreign), "ok") << "it is there still";
}

TEST_F(KafkaUsers, TheThiefOfAGatewayWhoSendsWithoutEndHasToWaitAndOthersGoOn) {
  const Attempts thief(server_->url(), "gateway-1"), other(server_->url(), "gateway-2");
  const auto sends = thief.sender();
  EXPECT_TRUE(thief.flood(sends.get(), "gateway-1.turtle.flood"));
  EXPECT_EQ(other.publish("gateway-2.turtle.data"), "ok");
  rd_kafka_purge(sends.get(), RD_KAFKA_PURGE_F_QUEUE | RD_KAFKA_PURGE_F_INFLIGHT);
}

/// SECURITY.md, "Floods".
TEST_F(KafkaUsers, TheThiefOfAGatewayMakesTopicsBelowItsNameAndNobodyCountsThemOrWhatTheyKeep) {
  const Attempts thief(server_->url(), "gateway-1");
  for (int number = 0; number < 20; ++number)
    ASSERT_EQ(thief.make_topic("gateway-1.many" + std::to_string(number)), "ok") << number;
  const std::string greedy = "gateway-1.greedy";
  EXPECT_EQ(thief.make_topic(greedy, {{"retention.ms", "-1"}, {"retention.bytes", "-1"}}), "ok");
  EXPECT_THAT(thief.settings_of(greedy),
              testing::AllOf(testing::HasSubstr("\nretention.ms=-1\n"), testing::HasSubstr("\nretention.bytes=-1\n")))
      << "for ever, and without an end";
}

/// SECURITY.md: whoever has a place in the network of docker-compose.yml.
TEST_F(KafkaUsers, AListenerOnTheWayHearsPasswordsAndMessages) {
  const tests::TamperingProxy listener(static_cast<std::uint16_t>(telling_port_),
                                       static_cast<std::uint16_t>(told_port_));
  BrokerOptions options = options_of("gateway-2");
  options.urls = {"kafka://127.0.0.1:" + std::to_string(telling_port_)};
  const auto gateway = make_broker(options);
  const auto sends = gateway->publisher({"", "gateway-2.turtle.heard", false}, {});
  sends->publish(text_message("what the robot sees"));
  EXPECT_TRUE(sends->drain(patience));
  EXPECT_THAT(listener.heard(),
              testing::AllOf(testing::HasSubstr(password), testing::HasSubstr("what the robot sees")));
}

TEST_F(KafkaUsers, TheThiefOfAGatewayHasNoUseOfWhatIsOpenOnceTheGatewayIsCutOff) {
  const std::string topic = "gateway-2.turtle.open";
  const Attempts thief(server_->url(), "gateway-2");
  const auto sends = thief.sender();
  EXPECT_EQ(Attempts::send(sends.get(), topic), "ok");
  const auto reads = thief.reader(topic);
  EXPECT_EQ(Attempts::news(reads.get()), "ok");
  server_->command("cut_off", "CUT_OFF");
  EXPECT_TRUE(eventually([&] { return Attempts::send(sends.get(), topic) == not_for_topic; }, patience));
  EXPECT_TRUE(eventually([&] { return Attempts::news(reads.get()) == not_for_topic; }, patience));
  EXPECT_EQ(thief.publish(topic), not_for_topic) << "who logs in anew";
  EXPECT_EQ(thief.join(topic, topic), not_for_group);
  server_->command("let_in", "LET_IN");
}

TEST_F(KafkaUsers, WorkersReachTheGatewaysTopicsOnly) {
  const Attempts workers(server_->url(), "workers");
  for (const auto& topic : {"gateway-1.turtle.echo", "gateway-2.turtle.echo"}) {
    EXPECT_EQ(workers.publish(topic), "ok");
    EXPECT_EQ(workers.join("echo", topic), "ok");
    EXPECT_EQ(workers.join("echo#1", topic), "ok");
    EXPECT_EQ(workers.join("record-0a1b2c3d", topic), "ok") << "a recording, which is a group of its own";
    EXPECT_EQ(workers.join("other", topic), not_for_group);
    EXPECT_EQ(workers.remove_topic(topic), not_for_topic);
  }
  EXPECT_EQ(workers.publish("gateway-3.turtle.echo"), not_for_topic);
  EXPECT_EQ(workers.take_rights("gateway-3.turtle.echo"), not_for_cluster);
}

TEST_F(KafkaUsers, NobodyGetsInWithoutAPasswordOrWithAWrongOne) {
  BrokerOptions wrong = options_of("gateway-1");
  wrong.password_file = (server_->folder() / "wrong").string();
  std::ofstream(wrong.password_file) << "guessed\n";
  BrokerOptions nobody = options_of("");
  nobody.password_file.clear();
  for (const auto& options : {wrong, nobody}) {
    const tests::CapturedLog log;
    const auto broker = make_broker(options);
    const auto publisher = broker->publisher({"", "gateway-1.turtle.data", false}, {});
    publisher->publish(text_message("x"));
    EXPECT_TRUE(eventually([&] { return log.contains("cannot connect"); }, patience)) << log.text();
    EXPECT_FALSE(publisher->drain(moment));
  }
}

}  // namespace
}  // namespace iotcloud::brokers
