// What an endpoint reads from a channel's record: records of the original, and of older gateways of ours.
#include <gtest/gtest.h>

#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/topology/endpoints/services.h>

namespace iotcloud::topology {
namespace {

discovery::ChannelRecord record_with(std::map<std::string, std::string> properties, const std::string& url) {
  discovery::ChannelRecord record;
  record.name = "up";
  record.transport = "robots";
  record.gateway = "g"_gateway;
  record.driver = "d"_driver;
  record.instance = "one"_instance;
  record.properties = std::move(properties);
  record.broker_url = url;
  return record;
}

std::vector<std::string> urls_of(const discovery::ChannelRecord& channel) {
  EndpointServices without_options;
  return address_of(channel, without_options).urls;
}

TEST(EndpointServices, ARecordOfTheOriginalNamesItsTopicWithoutThePrefix) {
  const auto record = record_with({{"exchange", "kinect"}, {"routingKey", "rk"}, {"queueName", "q"}}, "amqp://h:5672");
  EXPECT_EQ(topic_of(record), (brokers::Topic{"kinect", "g.d.one.rk", false}));
  EXPECT_EQ(misfit(record, discovery::Direction::out, "robots"), "");
  EXPECT_EQ(urls_of(record), std::vector<std::string>{"amqp://h:5672"});
}

TEST(EndpointServices, AKafkaServerOfTheOriginalHasNoScheme) {
  auto record = record_with({{"topic", "t"}}, "h:9092");
  record.shared = true;
  EXPECT_EQ(topic_of(record).name, "g.d.t");
  EXPECT_EQ(urls_of(record), std::vector<std::string>{"kafka://h:9092"});
}

TEST(EndpointServices, ARecordOfTheOriginalWithTheNamesOfAllBrokersIsReadByItsOwn) {
  const std::map<std::string, std::string> all{
      {"exchange", "e"}, {"routingKey", "rk"}, {"queueName", "q"}, {"topic", "t"}};
  EXPECT_EQ(topic_of(record_with(all, "amqp://h:5672")), (brokers::Topic{"e", "g.d.one.rk", false}));
  auto record = record_with(all, "h:9092");
  record.shared = true;
  EXPECT_EQ(topic_of(record), (brokers::Topic{"", "g.d.t", false}));
  EXPECT_EQ(urls_of(record), std::vector<std::string>{"kafka://h:9092"});
}

TEST(EndpointServices, ARecordOfAnOlderGatewayNamesItsTopicWhole) {
  const auto record = record_with({{"exchange", "d"}, {"routingKey", "g.d.one.up"}, {"durable", "true"}}, "amqp://h/");
  EXPECT_EQ(topic_of(record), (brokers::Topic{"d", "g.d.one.up", true}));
}

TEST(EndpointServices, ARecordWithoutANameCannotBeUsed) {
  EXPECT_EQ(misfit(record_with({{"exchange", "d"}}, "amqp://h/"), discovery::Direction::out, "robots"),
            "its record names no topic");
}

}  // namespace
}  // namespace iotcloud::topology
