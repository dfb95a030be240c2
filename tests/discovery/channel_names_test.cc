#include <gtest/gtest.h>

#include <iotcloud/discovery/channel_names.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::discovery {
namespace {

ChannelRecord record_with(std::map<std::string, std::string> properties, bool shared = false) {
  ChannelRecord record;
  record.gateway = "gw"_gateway;
  record.driver = "turtle"_driver;
  record.instance = "0a1b"_instance;
  record.shared = shared;
  record.properties = std::move(properties);
  return record;
}

TEST(ChannelNames, TheReaderPutsThePrefixBeforeTheNameInTheRecord) {
  EXPECT_EQ(wire_name(record_with({{"routingKey", "kinect"}})), "gw.turtle.0a1b.kinect");
  EXPECT_EQ(wire_name(record_with({{"routingKey", "kinect"}}, true)), "gw.turtle.kinect");
  EXPECT_EQ(wire_name(record_with({{"topic", "frames"}}, true)), "gw.turtle.frames");
  EXPECT_EQ(wire_name(record_with({{"queueName", "q"}})), "gw.turtle.0a1b.q");
}

TEST(ChannelNames, TheTopicIsTheRoutingKeyAndTheOriginalsQueueHasTheQueuesName) {
  const auto record = record_with({{"routingKey", "depth"}, {"queueName", "frames"}});
  EXPECT_EQ(wire_name(record), "gw.turtle.0a1b.depth");
  EXPECT_EQ(original_queue(record), "gw.turtle.0a1b.frames");
}

TEST(ChannelNames, OfAllNamesThatADriverGaveTheBrokerDecidesWhichIsTheTopics) {
  const std::map<std::string, std::string> all{
      {"exchange", "e"}, {"routingKey", "key"}, {"queueName", "queue"}, {"topic", "topic"}};
  auto record = record_with(all, true);
  for (const char* url : {"kafka://h:9092", "kafkas://h:9093", "h:9092"}) {
    record.broker_url = url;
    EXPECT_TRUE(is_on_kafka(record)) << url;
    EXPECT_EQ(wire_name(record), "gw.turtle.topic") << url;
  }
  for (const char* url : {"amqp://h:5672", "activemq://h:61616", "embedded://kafka"}) {
    record.broker_url = url;
    EXPECT_FALSE(is_on_kafka(record)) << url;
    EXPECT_EQ(wire_name(record), "gw.turtle.key") << url;
  }
  EXPECT_EQ(original_queue(record), "gw.turtle.queue");
  record.properties.erase("routingKey");
  EXPECT_EQ(wire_name(record), "gw.turtle.queue");
}

TEST(ChannelNames, AWholeNameThatAnOlderGatewayWroteIsTakenAsItIs) {
  EXPECT_EQ(wire_name(record_with({{"routingKey", "gw.turtle.0a1b.kinect"}, {"durable", "false"}})),
            "gw.turtle.0a1b.kinect");
  EXPECT_EQ(wire_name(record_with({{"topic", "gw.turtle.kinect"}, {"durable", "false"}}, true)), "gw.turtle.kinect");
}

TEST(ChannelNames, ANameOfTheOriginalThatBeginsLikeItsPrefixIsRawAllTheSame) {
  EXPECT_EQ(wire_name(record_with({{"routingKey", "gw.turtle.0a1b.kinect"}})), "gw.turtle.0a1b.gw.turtle.0a1b.kinect");
}

TEST(ChannelNames, ARecordWithoutAnyNameHasNoTopic) {
  EXPECT_EQ(wire_name(record_with({{"exchange", "turtle"}, {"routingKey", ""}})), "");
}

}  // namespace
}  // namespace iotcloud::discovery
