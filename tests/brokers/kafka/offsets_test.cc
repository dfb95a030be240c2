// What a group has committed, when its server does not say it. The server is librdkafka's mock, which fails on demand.
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include <gtest/gtest.h>
#include <librdkafka/rdkafka.h>
#include <librdkafka/rdkafka_mock.h>

#include "iotcloud/tests/brokers/contract_fixture.h"

namespace iotcloud::brokers {
namespace {

class KafkaOffsets : public testing::Test {
 protected:
  KafkaOffsets()
      : owner_(client(RD_KAFKA_PRODUCER, ""), &rd_kafka_destroy),
        cluster_(rd_kafka_mock_cluster_new(owner_.get(), 1), &rd_kafka_mock_cluster_destroy) {
    rd_kafka_mock_topic_create(cluster_.get(), topic().name.c_str(), 1, 1);
  }
  static Topic topic() { return {"", "gw.driver.readings", false}; }
  std::string address() const { return rd_kafka_mock_cluster_bootstraps(cluster_.get()); }
  std::unique_ptr<Broker> broker() const {
    BrokerOptions options;
    options.urls = {"kafka://" + address()};
    options.rpc_timeout = std::chrono::seconds(5);  // the mock never answers who makes topics
    return make_broker(options);
  }
  static SubscriptionOptions readers() {
    SubscriptionOptions options;
    options.group = "readers";
    return options;
  }
  /// As a tool of Kafka reads it; below 0: nothing was committed.
  std::int64_t committed() const {
    const std::unique_ptr<rd_kafka_t, decltype(&rd_kafka_destroy)> tool(client(RD_KAFKA_CONSUMER, address()),
                                                                        &rd_kafka_destroy);
    const std::unique_ptr<rd_kafka_topic_partition_list_t, decltype(&rd_kafka_topic_partition_list_destroy)> list(
        rd_kafka_topic_partition_list_new(1), &rd_kafka_topic_partition_list_destroy);
    rd_kafka_topic_partition_list_add(list.get(), topic().name.c_str(), 0);
    constexpr int limit_ms = std::chrono::milliseconds(patience).count();
    EXPECT_EQ(rd_kafka_committed(tool.get(), list.get(), limit_ms), RD_KAFKA_RESP_ERR_NO_ERROR);
    return list->elems[0].offset;
  }
  void refuse_the_next_question_for_offsets() const {
    constexpr std::int16_t offset_fetch = 9;
    rd_kafka_mock_push_request_errors(cluster_.get(), offset_fetch, 1, RD_KAFKA_RESP_ERR_GROUP_AUTHORIZATION_FAILED);
  }

 private:
  static rd_kafka_t* client(rd_kafka_type_t type, const std::string& address) {
    rd_kafka_conf_t* conf = rd_kafka_conf_new();
    rd_kafka_conf_set(conf, "bootstrap.servers", address.c_str(), nullptr, 0);
    if (type == RD_KAFKA_CONSUMER) rd_kafka_conf_set(conf, "group.id", "readers", nullptr, 0);
    return rd_kafka_new(type, conf, nullptr, 0);
  }

  const std::unique_ptr<rd_kafka_t, decltype(&rd_kafka_destroy)> owner_;
  const std::unique_ptr<rd_kafka_mock_cluster_t, decltype(&rd_kafka_mock_cluster_destroy)> cluster_;
};

TEST_F(KafkaOffsets, AReaderThatIsNotToldWhereItsGroupIsDoesNotSetTheGroupBack) {
  const auto device = broker();
  const auto publisher = device->publisher(topic(), {});
  for (int i = 0; i < 10; ++i) publisher->publish(text_message(std::to_string(i)));
  {
    const auto broker = this->broker();
    Inbox inbox;
    const auto subscription = broker->subscribe(topic(), readers(), inbox.handler());
    ASSERT_TRUE(inbox.wait_for(10));
  }
  ASSERT_EQ(committed(), 10);
  refuse_the_next_question_for_offsets();
  {
    const auto broker = this->broker();
    Inbox inbox;
    const auto subscription = broker->subscribe(topic(), readers(), inbox.handler());
    ASSERT_TRUE(eventually([&] { return subscription->active(); }, patience));
  }
  EXPECT_EQ(committed(), 10);
  refuse_the_next_question_for_offsets();
  const auto broker = this->broker();
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), readers(), inbox.handler());
  publisher->publish(text_message("new"));
  ASSERT_TRUE(inbox.wait_for(1));
  EXPECT_EQ(inbox.all().front().body, "new") << "it goes on where the group is";
}

}  // namespace
}  // namespace iotcloud::brokers
