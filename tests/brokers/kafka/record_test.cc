// The content of Kafka's records, and how foreign ones are read.
#include <array>
#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <librdkafka/rdkafka.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers {
namespace {

class KafkaRecord : public testing::Test {
 protected:
  static void SetUpTestSuite() { server_ = new tests::PrivateServer("kafka.py", {"--partitions", "1"}); }
  static void TearDownTestSuite() { delete std::exchange(server_, nullptr); }

  static BrokerOptions options(const std::string& envelope = "thrift") {
    BrokerOptions options;
    options.urls = {server_->url()};
    options.heartbeat = std::chrono::seconds(2);
    options.properties["envelope"] = envelope;
    return options;
  }
  static Topic topic() {
    return {"", std::string("gw.driver.") + testing::UnitTest::GetInstance()->current_test_info()->name(), false};
  }
  /// Produces a record as a foreign program would.
  static void produce(const std::string& key, const std::string& value, int headers = 0) {
    rd_kafka_conf_t* conf = rd_kafka_conf_new();
    const std::string address = server_->url().substr(std::string("kafka://").size());
    rd_kafka_conf_set(conf, "bootstrap.servers", address.c_str(), nullptr, 0);
    rd_kafka_t* producer = rd_kafka_new(RD_KAFKA_PRODUCER, conf, nullptr, 0);
    rd_kafka_topic_t* to = rd_kafka_topic_new(producer, topic().name.c_str(), nullptr);
    rd_kafka_headers_t* list = rd_kafka_headers_new(static_cast<std::size_t>(headers));
    for (int i = 0; i < headers; ++i) rd_kafka_header_add(list, std::to_string(i).c_str(), -1, "", 0);
    std::string copied_key = key, copied_value = value;  // the library takes pointers that are not const
    std::array<rd_kafka_vu_t, 5> fields{};
    fields[0].vtype = RD_KAFKA_VTYPE_RKT;
    fields[0].u.rkt = to;
    fields[1].vtype = RD_KAFKA_VTYPE_KEY;
    fields[1].u.mem = {copied_key.data(), copied_key.size()};
    fields[2].vtype = RD_KAFKA_VTYPE_VALUE;
    fields[2].u.mem = {copied_value.data(), copied_value.size()};
    fields[3].vtype = RD_KAFKA_VTYPE_MSGFLAGS;
    fields[3].u.i = RD_KAFKA_MSG_F_COPY;
    fields[4].vtype = RD_KAFKA_VTYPE_HEADERS;
    fields[4].u.headers = list;
    EXPECT_EQ(rd_kafka_produceva(producer, fields.data(), fields.size()), nullptr);
    EXPECT_EQ(rd_kafka_flush(producer, 60'000), RD_KAFKA_RESP_ERR_NO_ERROR);
    rd_kafka_topic_destroy(to);
    rd_kafka_destroy(producer);
  }
  static Message odd_message() {
    Message message = text_message("the body");
    message.driver_id = std::string("dr\0iver", 7);
    message.gateway_id = "gateway";
    message.time_ms = 1'700'000'000'123;
    message.properties.set(std::string("n\0l", 3), std::string(1, '\0'));
    message.properties.set("100 %00", "%25");
    message.properties.set("empty", "");
    return message;
  }
  static void expect_equal(const Message& received, const Message& sent) {
    EXPECT_EQ(received.payload, sent.payload);
    EXPECT_EQ(received.driver_id, sent.driver_id);
    EXPECT_EQ(received.gateway_id, sent.gateway_id);
    EXPECT_EQ(received.time_ms, sent.time_ms);
    EXPECT_EQ(received.properties, sent.properties);
  }

  static tests::PrivateServer* server_;
};

tests::PrivateServer* KafkaRecord::server_ = nullptr;

TEST_F(KafkaRecord, NativeHeadersCarryMetadataOfAnyBytesToEveryReader) {
  const auto sender = make_broker(options("headers"));
  const auto publisher = sender->publisher(topic(), {});
  publisher->publish(odd_message());
  for (const char* envelope : {"headers", "thrift"}) {
    const auto broker = make_broker(options(envelope));
    Inbox inbox;
    SubscriptionOptions reading;
    reading.group = envelope;
    const auto subscription = broker->subscribe(topic(), reading, inbox.handler());
    ASSERT_TRUE(inbox.wait_for(1));
    expect_equal(inbox.all().front().message, odd_message());
  }
}

TEST_F(KafkaRecord, WithNativeHeadersTheRecordsOfOthersAreBareBodies) {
  produce("their key", "their body");
  const auto broker = make_broker(options("headers"));
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for(1));
  EXPECT_EQ(inbox.bodies().front(), "their body");
  EXPECT_EQ(inbox.all().front().message.driver_id, "their key");
  EXPECT_GT(inbox.all().front().message.time_ms, 0) << "the record's own";
}

TEST_F(KafkaRecord, WhatIsNoMessageIsSkippedAndCountedAndNeverComesAgain) {
  produce("key", "garbage");
  produce("key", "");
  produce("key", std::string(1, '\0'));  // an empty struct: a message without any field
  config::Metrics metrics;
  BrokerOptions counting = options();
  counting.metrics = &metrics;
  auto broker = make_broker(counting);
  const auto skipped = [&] {
    return metrics.counter("iotcloud_broker_skipped_total", "", {{"broker", "kafka"}, {"reason", "undecodable"}})
        .value();
  };
  Inbox inbox;
  auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for(1));
  EXPECT_EQ(inbox.bodies().front(), "");
  EXPECT_EQ(inbox.all().front().message.driver_id, "key");
  EXPECT_EQ(skipped(), 2U);
  subscription.reset();
  broker = make_broker(counting);
  subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("after"));
  ASSERT_TRUE(inbox.wait_for_last("after"));
  EXPECT_EQ(skipped(), 2U);
}

TEST_F(KafkaRecord, WithMoreHeadersThanAnySenderOfOursWritesIsSkippedAndCounted) {
  produce("key", "as many as are read", 8192);
  produce("key", "one more", 8193);
  produce("key", "after it", 1);
  config::Metrics metrics;
  BrokerOptions counting = options("headers");
  counting.metrics = &metrics;
  const auto broker = make_broker(counting);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  ASSERT_TRUE(inbox.wait_for_last("after it"));
  EXPECT_THAT(inbox.bodies(), testing::ElementsAre("as many as are read", "after it"));
  EXPECT_EQ(
      metrics.counter("iotcloud_broker_skipped_total", "", {{"broker", "kafka"}, {"reason", "undecodable"}}).value(),
      1U);
}

TEST_F(KafkaRecord, ALargeBodyOutlivesItsBroker) {
  Inbox inbox;
  {
    const auto broker = make_broker(options());
    const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
    const auto publisher = broker->publisher(topic(), {});
    publisher->publish(text_message(std::string(1'000'000, 'x')));
    ASSERT_TRUE(inbox.wait_for(1));
  }
  EXPECT_EQ(inbox.all().front().message.payload.text(), std::string(1'000'000, 'x'));
}

TEST_F(KafkaRecord, WhatIsLargerThanTheTopicTakesIsRefused) {
  BrokerOptions small = options();
  small.properties["max_message_bytes"] = "10000";
  const auto broker = make_broker(small);
  PublisherOptions publishing;
  Outcomes outcomes;
  publishing.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic(), publishing);
  publisher->publish(text_message(std::string(20'000, 'x')));
  publisher->publish(text_message("small"));
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_EQ(outcomes.of(1), Outcome::refused);
  EXPECT_EQ(outcomes.of(2), Outcome::confirmed);
}

TEST_F(KafkaRecord, WhatIsTooLargeTogetherIsTakenAlone) {
  BrokerOptions small = options();
  small.properties["max_message_bytes"] = "10000";
  {
    const auto operators = make_broker(small);
    const auto first = operators->publisher(topic(), {});
    first->publish(text_message("0"));
    ASSERT_TRUE(first->drain(patience));
  }
  // This client does not know the topic's limit.
  const auto broker = make_broker(options());
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  PublisherOptions publishing;
  Outcomes outcomes;
  publishing.on_outcome = outcomes.callback();
  const auto publisher = broker->publisher(topic(), publishing);
  // Most are published before the producer has found the topic, so they go together.
  std::vector<std::string> taken{"0"};
  for (int i = 1; i <= 101; ++i) {
    const std::string body = std::to_string(i) + std::string(i == 51 ? 20'000 : 1000, ' ');
    if (i != 51) taken.push_back(body);
    publisher->publish(text_message(body));
  }
  ASSERT_TRUE(publisher->drain(patience));
  EXPECT_TRUE(outcomes.each_once());
  EXPECT_EQ(outcomes.count(Outcome::confirmed), 100U);
  EXPECT_EQ(outcomes.of(51), Outcome::refused);
  ASSERT_TRUE(inbox.wait_for(101));
  std::vector<std::string> arrived;
  for (const auto& received : inbox.all()) arrived.push_back(received.body);
  EXPECT_EQ(arrived, taken);
}

TEST_F(KafkaRecord, WhatASpoolSendsAgainIsFlagged) {
  const auto broker = make_broker(options());
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish_again(text_message("again"), {true, {}});
  publisher->publish(text_message("new"));
  ASSERT_TRUE(inbox.wait_for(2));
  EXPECT_TRUE(inbox.all()[0].redelivered);
  EXPECT_FALSE(inbox.all()[1].redelivered);
}

TEST(KafkaRecordOptions, WhatMakesNoSenseIsAnErrorThatSaysWhy) {
  const auto error = [](const std::string& name, const std::string& value) -> std::string {
    BrokerOptions options;
    options.urls = {"kafka://127.0.0.1:1"};
    options.properties[name] = value;
    try {
      make_broker(options);
    } catch (const config::Error& refused) {
      return refused.what();
    }
    return "none";
  };
  EXPECT_THAT(error("envelope", "avro"), testing::HasSubstr("thrift or headers"));
  EXPECT_THAT(error("partitions", "0"), testing::HasSubstr("from 1 to"));
  EXPECT_THAT(error("partitions", "many"), testing::HasSubstr("many"));
  EXPECT_THAT(error("color", "red"), testing::HasSubstr("envelope, partitions, replication"));
  BrokerOptions options;
  options.urls = {"kafka://127.0.0.1:1"};
  EXPECT_THROW(make_broker(options)->publisher({"", "no spaces", false}, {}), config::Error);
}

}  // namespace
}  // namespace iotcloud::brokers
