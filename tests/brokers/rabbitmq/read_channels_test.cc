#include "iotcloud/brokers/rabbitmq/read_channels.h"

#include <memory>
#include <optional>
#include <string>

#include <gtest/gtest.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

class RabbitMqReadChannels : public testing::Test {
 protected:
  /// A subscription that has a channel.
  std::shared_ptr<QueueReader> open(const std::string& queue) {
    Topic topic;
    topic.name = queue;
    auto reader = std::make_shared<QueueReader>(nullptr, QueueType::classic, topic, SubscriptionOptions{}, Handler{});
    channels_.open(reader);
    return reader;
  }

  ReadChannels channels_;
};

TEST_F(RabbitMqReadChannels, ANumberIsGivenAgainOnlyWhenTheServerHasAnsweredItsClose) {
  const auto first = open("a");
  const auto second = open("b");
  const auto third = open("c");
  EXPECT_EQ(first->channel, 1);
  EXPECT_EQ(second->channel, 2);
  EXPECT_EQ(third->channel, 3);
  channels_.close(*second);
  EXPECT_EQ(second->channel, 0);
  EXPECT_EQ(open("d")->channel, 4);
  EXPECT_EQ(channels_.size(), 4u);
  channels_.closed(2);
  EXPECT_EQ(open("e")->channel, 2);
}

TEST_F(RabbitMqReadChannels, WhoseEndWasRequestedGetsNoMoreFrames) {
  const auto reader = open("a");
  EXPECT_EQ(channels_.find(1), std::optional<QueueReader*>(reader.get()));
  channels_.close(*reader);
  EXPECT_EQ(channels_.find(1), std::optional<QueueReader*>(nullptr));
  channels_.closed(1);
  EXPECT_EQ(channels_.find(1), std::nullopt);
}

TEST_F(RabbitMqReadChannels, AChannelThatTheServerClosedIsFreeAtOnceAndIsAnsweredOnIt) {
  const auto reader = open("a");
  channels_.closed_by_server(1);
  EXPECT_EQ(channels_.find(1), std::nullopt);
  EXPECT_EQ(channels_.size(), 0u);
  EXPECT_FALSE(channels_.all_written());  // close-ok
  EXPECT_EQ(open("b")->channel, 1);
}

TEST_F(RabbitMqReadChannels, ALostConnectionForgetsItsChannelsAndWhatWasToBeSent) {
  const auto reader = open("a");
  EXPECT_FALSE(channels_.all_written());
  channels_.clear();
  EXPECT_TRUE(channels_.all_written());
  EXPECT_EQ(open("b")->channel, 1);
}

}  // namespace
}  // namespace iotcloud::brokers::rabbitmq
