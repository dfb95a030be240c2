#include <string>
#include <type_traits>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/gateway/host/channel_plan.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::gateway {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

// Arguments that are swapped do not compile: the names of topics are made of them.
template <typename Gateway, typename Driver>
inline constexpr bool plans = std::is_invocable_v<decltype(plan_channels), const Gateway&, const Driver&,
                                                  const InstanceSpec&, std::vector<drivers::ChannelSpec>>;
static_assert(plans<discovery::GatewayId, discovery::DriverName>);
static_assert(!plans<discovery::DriverName, discovery::GatewayId>);
static_assert(!plans<std::string, std::string>);

InstanceSpec instance(std::map<std::string, std::string> properties = {}) {
  InstanceSpec spec;
  spec.order.instance = "0a1b"_instance;
  spec.order.properties = std::move(properties);
  spec.brokers = {{"rabbitmq", "rabbitmq", {}, {"amqp://own"}, {"amqp://shared"}},
                  {"kafka", "kafka", {}, {"kafka://own"}, {"kafka://s"}}};
  return spec;
}

drivers::ChannelSpec channel(const std::string& name, bool shared = false) {
  drivers::ChannelSpec spec;
  spec.name = name;
  spec.shared = shared;
  return spec;
}

std::string error_of(const InstanceSpec& spec, const std::vector<drivers::ChannelSpec>& wanted) {
  try {
    plan_channels("gw1"_gateway, "turtle"_driver, spec, wanted);
  } catch (const config::Error& e) {
    return e.what();
  }
  return "";
}

TEST(ChannelPlan, AnExclusiveChannelIsNamedAfterGatewayDriverAndInstance) {
  const auto planned = plan_channels("gw1"_gateway, "turtle"_driver, instance(), {channel("kinect")}).at(0);
  EXPECT_EQ(planned.topic, (brokers::Topic{"turtle", "gw1.turtle.0a1b.kinect", false}));
  EXPECT_EQ(planned.record.properties,
            (std::map<std::string, std::string>{
                {"exchange", "turtle"}, {"routingKey", "kinect"}, {"queueName", "kinect"}, {"durable", "false"}}));
  EXPECT_EQ(planned.record.broker_url, "amqp://own");
  EXPECT_EQ(planned.record.transport, "rabbitmq");
  EXPECT_EQ(planned.record.gateway, "gw1");
  EXPECT_EQ(planned.record.driver, "turtle");
  EXPECT_EQ(planned.record.instance, "0a1b");
  EXPECT_FALSE(planned.record.shared);
}

TEST(ChannelPlan, ASharedChannelIsNamedAfterGatewayAndDriverOnTheGroupsServer) {
  const auto planned = plan_channels("gw1"_gateway, "turtle"_driver, instance(), {channel("kinect", true)}).at(0);
  EXPECT_EQ(planned.topic.name, "gw1.turtle.kinect");
  EXPECT_EQ(planned.record.broker_url, "amqp://shared");
  EXPECT_TRUE(planned.record.shared);
}

TEST(ChannelPlan, TheBrokersExchangeIsThatOfChannelsWhoseDriverNamesNone) {
  auto spec = instance();
  spec.brokers.front().options.properties = {{"exchange", "amq.topic"}};
  auto named = channel("named");
  named.properties = {{"exchange", "own"}};
  auto kept = channel("kept");
  kept.durable = true;
  const auto planned = plan_channels("gw1"_gateway, "turtle"_driver, spec, {channel("kinect"), named, kept});
  EXPECT_EQ(planned.at(0).topic.exchange, "amq.topic");
  EXPECT_EQ(planned.at(0).record.properties.at("exchange"), "amq.topic");
  EXPECT_EQ(planned.at(1).topic.exchange, "own");
  EXPECT_EQ(planned.at(2).topic.exchange, "amq.topic");
}

TEST(ChannelPlan, TheOtherServersOfAClusterStandInTheRecordToo) {
  auto spec = instance();
  spec.brokers.front().exclusive_urls = {"amqp://b/", "amqp://c/", "amqp://a/"};
  spec.brokers.front().options.user = "gateway";
  const auto planned = plan_channels("gw1"_gateway, "turtle"_driver, spec, {channel("kinect")}).at(0);
  EXPECT_EQ(planned.address, (brokers::BrokerAddress{"rabbitmq", spec.brokers.front().exclusive_urls}));
  EXPECT_EQ(planned.broker.user, "gateway");
  EXPECT_EQ(planned.record.broker_url, "amqp://b/");
  EXPECT_EQ(planned.record.properties.at("urls"), "amqp://b/ amqp://c/ amqp://a/");
}

TEST(ChannelPlan, ForTopologiesOfTheOriginalTheTopicHasAQueueOfItsOwn) {
  EXPECT_FALSE(plan_channels("gw1"_gateway, "turtle"_driver, instance(), {channel("kinect")}).at(0).own_queue);
  auto wanted = channel("kinect");
  wanted.properties = {{"routingKey", "depth"}, {"queueName", "frames"}};
  const auto planned =
      plan_channels("gw1"_gateway, "turtle"_driver, instance({{"channel.kinect.interop", "java"}}), {wanted}).at(0);
  EXPECT_TRUE(planned.own_queue);
  EXPECT_EQ(planned.original_queue, "gw1.turtle.0a1b.frames");
  EXPECT_THAT(error_of(instance({{"channel.kinect.interop", "java"}, {"channel.kinect.durable", "true"}}), {wanted}),
              HasSubstr("leave one of the two out"));
  EXPECT_THAT(error_of(instance({{"channel.kinect.interop", "go"}}), {channel("kinect")}), HasSubstr("it can be java"));
}

TEST(ChannelPlan, AnUnusualPriorityStandsInTheRecord) {
  const auto planned =
      plan_channels("gw1"_gateway, "turtle"_driver, instance({{"channel.kinect.priority", "9"}}), {channel("kinect")})
          .at(0);
  EXPECT_EQ(planned.spec.priority, 9);
  EXPECT_EQ(planned.record.properties.at("priority"), "9");
  EXPECT_THAT(error_of(instance({{"channel.kinect.priority", "10"}}), {channel("kinect")}), HasSubstr("from 0 to 9"));
}

TEST(ChannelPlan, NamesThatTheDriverGivesFollowThePrefix) {
  auto wanted = channel("kinect");
  wanted.properties = {{"exchange", "sensors"}, {"routingKey", "depth"}, {"queueName", "frames"}};
  const auto planned = plan_channels("gw1"_gateway, "turtle"_driver, instance(), {wanted}).at(0);
  EXPECT_EQ(planned.topic, (brokers::Topic{"sensors", "gw1.turtle.0a1b.depth", false}));
  EXPECT_EQ(planned.record.properties.at("routingKey"), "depth");
  EXPECT_EQ(planned.record.properties.at("queueName"), "frames");
}

TEST(ChannelPlan, AllNamesThatTheDriverGivesStandInTheRecordWhateverTheBroker) {
  const std::map<std::string, std::string> names{
      {"exchange", "sensors"}, {"routingKey", "depth"}, {"queueName", "frames"}, {"topic", "images"}};
  auto wanted = channel("kinect", true);
  wanted.properties = {names.begin(), names.end()};
  for (const char* broker : {"rabbitmq", "kafka"}) {
    wanted.broker = broker;
    const auto planned = plan_channels("gw1"_gateway, "turtle"_driver, instance(), {wanted}).at(0);
    for (const auto& [name, value] : names) EXPECT_EQ(planned.record.properties.at(name), value) << broker;
    const bool on_kafka = wanted.broker == "kafka";
    EXPECT_EQ(planned.topic,
              (brokers::Topic{on_kafka ? "" : "sensors", on_kafka ? "gw1.turtle.images" : "gw1.turtle.depth", false}));
  }
  wanted.properties = {{"routingKey", "depth"}};
  EXPECT_EQ(plan_channels("gw1"_gateway, "turtle"_driver, instance(), {wanted}).at(0).topic.name, "gw1.turtle.kinect")
      << "on Kafka the topic has the channel's name all the same";
}

TEST(ChannelPlan, ANameThatReadersWouldTakeForAWholeWireNameIsRefused) {
  auto wanted = channel("kinect");
  wanted.properties = {{"routingKey", "gw1.turtle.0a1b.kinect"}};
  EXPECT_THAT(error_of(instance(), {wanted}),
              AllOf(HasSubstr("\"routingKey\" is \"gw1.turtle.0a1b.kinect\""), HasSubstr("leave that out")));
}

TEST(ChannelPlan, ADurableChannelHasAnExchangeOfItsOwn) {
  const auto planned = plan_channels("gw1"_gateway, "turtle"_driver, instance({{"channel.log.durable", "true"}}),
                                     {channel("log"), channel("kinect")});
  EXPECT_EQ(planned.at(0).topic, (brokers::Topic{"turtle.durable", "gw1.turtle.0a1b.log", true}));
  EXPECT_EQ(planned.at(0).record.properties.at("durable"), "true");
  EXPECT_EQ(planned.at(1).topic.exchange, "turtle");
}

TEST(ChannelPlan, TheDeploymentOverridesTheQualityOfService) {
  const auto planned = plan_channels("gw1"_gateway, "turtle"_driver,
                                     instance({{"channel.kinect.capacity", "2"},
                                               {"channel.kinect.when_full", "keep_newest"},
                                               {"channel.kinect.deadline_ms", "150"},
                                               {"channel.kinect.keep_last", "1"},
                                               {"channel.kinect.shared", "true"},
                                               {"channel.kinect.broker", "kafka"},
                                               {"seed", "7"}}),
                                     {channel("kinect")})
                           .at(0);
  EXPECT_EQ(planned.spec.capacity, 2u);
  EXPECT_EQ(planned.spec.when_full, drivers::WhenFull::keep_newest);
  EXPECT_EQ(planned.spec.deadline, std::chrono::milliseconds(150));
  EXPECT_EQ(planned.spec.keep_last, 1u);
  EXPECT_EQ(planned.record.transport, "kafka");
  EXPECT_EQ(planned.record.properties.at("topic"), "kinect");
  EXPECT_EQ(planned.topic.name, "gw1.turtle.kinect");
}

TEST(ChannelPlan, AnOverrideThatCannotBeIsNamedWithWhatWouldBeRight) {
  EXPECT_THAT(error_of(instance({{"channel.kinect.capasity", "2"}}), {channel("kinect")}),
              AllOf(HasSubstr("channel.kinect.capasity"), HasSubstr("did you mean \"capacity\"?")));
  EXPECT_THAT(error_of(instance({{"channel.camera.capacity", "2"}}), {channel("kinect")}),
              AllOf(HasSubstr("no channel \"camera\""), HasSubstr("kinect")));
  EXPECT_THAT(error_of(instance({{"channel.kinect.capacity", "0"}}), {channel("kinect")}), HasSubstr("from 1 to"));
  EXPECT_THAT(error_of(instance({{"channel.kinect.capacity", "x"}}), {channel("kinect")}), HasSubstr("\"x\""));
  EXPECT_THAT(error_of(instance({{"channel.kinect.when_full", "keep"}}), {channel("kinect")}),
              HasSubstr("keep_newest, block, spool"));
  EXPECT_THAT(error_of(instance({{"channel.capacity", "1"}}), {channel("kinect")}), HasSubstr("channel.capacity"));
}

TEST(ChannelPlan, AChannelMayBeSpooledToDisk) {
  const auto planned = plan_channels("gw1"_gateway, "meter"_driver,
                                     instance({{"channel.readings.when_full", "spool"},
                                               {"channel.readings.spool_bytes", "1000000"},
                                               {"channel.readings.spool_fsync", "always"},
                                               {"channel.readings.spool_full", "drop_oldest"}}),
                                     {channel("readings")})
                           .at(0);
  EXPECT_EQ(planned.spec.when_full, drivers::WhenFull::spool);
  EXPECT_EQ(planned.spec.spool.bytes, 1'000'000u);
  EXPECT_EQ(planned.spec.spool.fsync, drivers::Spool::Fsync::always);
  EXPECT_EQ(planned.spec.spool.full, drivers::Spool::Full::drop_oldest);
}

TEST(ChannelPlan, OptionsOfASpoolThatCannotBeAreErrors) {
  const auto error = [](std::map<std::string, std::string> more) {
    more["channel.c.when_full"] = "spool";
    return error_of(instance(std::move(more)), {channel("c")});
  };
  EXPECT_EQ(error({}), "");
  EXPECT_THAT(error({{"channel.c.spool_bytes", "10"}}), HasSubstr("from 65536"));
  EXPECT_THAT(error({{"channel.c.spool_fsync", "yes"}}), HasSubstr("never, interval, always"));
  EXPECT_THAT(error({{"channel.c.spool_full", "keep_newest"}}), HasSubstr("block, drop_oldest"));
  EXPECT_THAT(error_of(instance({{"channel.c.spool_bytes", "100000"}}), {channel("c")}),
              HasSubstr("set channel.c.when_full to spool"));
}

TEST(ChannelPlan, AnUnknownBrokerIsAnErrorThatListsThoseThereAre) {
  EXPECT_THAT(error_of(instance({{"channel.kinect.broker", "rabbit"}}), {channel("kinect")}),
              AllOf(HasSubstr("\"rabbit\""), HasSubstr("rabbitmq, kafka")));
}

TEST(ChannelPlan, AnExclusiveChannelOnKafkaIsAnError) {
  EXPECT_THAT(error_of(instance({{"channel.kinect.broker", "kafka"}}), {channel("kinect")}),
              HasSubstr("shared channels only"));
}

TEST(ChannelPlan, TwoChannelsOfOneNameAreAnError) {
  EXPECT_THAT(error_of(instance(), {channel("kinect"), channel("kinect")}), HasSubstr("two channels named \"kinect\""));
}

}  // namespace
}  // namespace iotcloud::gateway
