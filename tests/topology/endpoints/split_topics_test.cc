// How often the topics of shared channels are split, with a broker that says what the test wants.
#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/error.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/topology/endpoints/receiving/split_topics.h>

namespace iotcloud::topology {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using tests::eventually;

/// Splits topics, unless told otherwise, and knows who follows which.
class SplittingBroker final : public brokers::Broker {
 public:
  std::unique_ptr<brokers::Publisher> publisher(const brokers::Topic&, const brokers::PublisherOptions&) override {
    return nullptr;
  }
  std::unique_ptr<brokers::Subscription> subscribe(const brokers::Topic&, const brokers::SubscriptionOptions&,
                                                   brokers::Handler) override {
    return nullptr;
  }
  std::unique_ptr<brokers::PartitionWatch> watch_partitions(const brokers::Topic& topic,
                                                            const std::function<void(int)>& told) override {
    if (!splits_) return nullptr;
    watches_[topic.name] = told;
    return std::make_unique<Watch>(*this, topic.name);
  }
  brokers::ConnectionState state() const override { return brokers::ConnectionState::connected; }
  const std::string& url() const override { return url_; }

  void split_nothing() { splits_ = false; }
  void tell(const std::string& topic, int count) { watches_.at(topic)(count); }
  bool is_followed(const std::string& topic) const { return watches_.contains(topic); }

 private:
  struct Watch final : brokers::PartitionWatch {
    Watch(SplittingBroker& of, std::string name) : broker(of), topic(std::move(name)) {}
    ~Watch() override { broker.watches_.erase(topic); }
    Watch(const Watch&) = delete;
    Watch& operator=(const Watch&) = delete;
    SplittingBroker& broker;
    const std::string topic;
  };
  const std::string url_ = "splitting://here";
  bool splits_ = true;
  std::map<std::string, std::function<void(int)>> watches_;
};

class SplitTopicsTest : public testing::Test {
 protected:
  SplitTopicsTest() : registry_(discovery::make_registry({.url = "embedded://" + name()})) {}

  static std::string name() {
    return std::string("split-") + testing::UnitTest::GetInstance()->current_test_info()->name();
  }
  std::unique_ptr<SplitTopics> spout() {
    SplitTopics::Options options;
    options.component = "in";
    options.group = "t";
    options.registry = registry_.get();
    options.agreement = agreement_;
    options.broker_at = [this](const brokers::BrokerAddress& address) -> std::shared_ptr<brokers::Broker> {
      if (address.broker == "unknown") throw config::Error("no such broker");
      return broker_;
    };
    options.on_change = [this] { ++changes_; };
    auto topics = std::make_unique<SplitTopics>(std::move(options));
    topics->begin();
    return topics;
  }
  static discovery::ChannelRecord channel(const std::string& instance, const std::string& name = "up") {
    discovery::ChannelRecord channel;
    channel.name = name;
    channel.driver = "d"_driver;
    channel.gateway = "g"_gateway;
    channel.instance = discovery::InstanceId(instance);
    channel.shared = true;
    return channel;
  }
  static SplitTopics::Key topic(const std::string& name, const std::string& broker = "kafka") {
    return {{broker, {"splitting://here"}}, {"", name, false}};
  }
  /// What the spout takes over after on_change was called once more.
  SplitTopics::Changes next_changes(SplitTopics& topics) {
    ++expected_;
    EXPECT_TRUE(eventually([&] { return changes_ >= expected_; })) << changes_;
    return topics.take_changes();
  }
  static PartitionAgreement::Source source(const std::string& instance = "i1") {
    return {"t", "d"_driver, "g"_gateway, discovery::InstanceId(instance)};
  }

  static SplitTopics::Layout split(int partitions) { return {.exclusive = false, .partitions = partitions}; }

  const std::unique_ptr<discovery::Registry> registry_;
  const std::shared_ptr<PartitionAgreement> agreement_ = std::make_shared<PartitionAgreement>();
  const std::shared_ptr<SplittingBroker> broker_ = std::make_shared<SplittingBroker>();
  std::atomic<int> changes_{0};  ///< calls of on_change
  int expected_ = 0;             ///< of them, those that next_changes() has waited for
};

TEST_F(SplitTopicsTest, ATopicHasOnePartitionUntilTheBrokerTellsHowManyItHas) {
  const auto topics = spout();
  EXPECT_EQ(topics->follow(channel("i1"), topic("x")), 1);
  EXPECT_EQ(topics->follow(channel("i2"), topic("x")), 1);
  EXPECT_EQ(topics->follow(channel("i3"), topic("y")), 1);
  broker_->tell("x", 4);
  const auto changes = next_changes(*topics);
  EXPECT_FALSE(changes.all);
  EXPECT_THAT(changes.instances, ElementsAre("i1"_instance, "i2"_instance));
  EXPECT_EQ(topics->follow(channel("i1"), topic("x")), 4);
  EXPECT_EQ(topics->follow(channel("i3"), topic("y")), 1);
}

TEST_F(SplitTopicsTest, TheSameNumberAgainConcernsNoChannel) {
  const auto topics = spout();
  topics->follow(channel("i1"), topic("x"));
  broker_->tell("x", 1);
  EXPECT_THAT(next_changes(*topics).instances, IsEmpty());
}

TEST_F(SplitTopicsTest, ABrokerThatSplitsNothingOrCannotBeUsedHasNoPartitions) {
  const auto topics = spout();
  EXPECT_EQ(topics->follow(channel("i1"), topic("x", "unknown")), std::nullopt);
  broker_->split_nothing();
  EXPECT_EQ(topics->follow(channel("i2"), topic("x")), std::nullopt);
}

TEST_F(SplitTopicsTest, ATopicIsFollowedUntilTheLastOfItsChannelsForgetsIt) {
  const auto topics = spout();
  topics->follow(channel("i1"), topic("x"));
  topics->follow(channel("i2"), topic("x"));
  topics->forget(channel("i1"), topic("x"));
  EXPECT_TRUE(broker_->is_followed("x"));
  topics->forget(channel("i2"), topic("x"));
  EXPECT_FALSE(broker_->is_followed("x"));
  topics->forget(channel("i2"), topic("x"));
}

TEST_F(SplitTopicsTest, ANumberThatComesForAForgottenTopicChangesNothing) {
  const auto topics = spout();
  topics->follow(channel("i1"), topic("x"));
  broker_->tell("x", 4);
  topics->forget(channel("i1"), topic("x"));
  EXPECT_THAT(next_changes(*topics).instances, IsEmpty());
  EXPECT_EQ(topics->follow(channel("i1"), topic("x")), 1);
}

TEST_F(SplitTopicsTest, AllChannelsArePlacedAnewWhenThoseOfADriverAgreeNoLongerAndAgain) {
  const auto topics = spout();
  topics->follow(channel("i1"), topic("x"));
  broker_->tell("x", 4);
  next_changes(*topics);
  EXPECT_THAT(topics->difference(channel("i1")), IsEmpty());

  agreement_->set(source(), "side", split(2));  // as another spout of the worker does
  EXPECT_TRUE(next_changes(*topics).all);
  EXPECT_THAT(topics->difference(channel("i1")), HasSubstr("\"side\" and \"up\" have 2 and 4 partitions"));
  agreement_->set(source(), "side", split(4));
  EXPECT_TRUE(next_changes(*topics).all);
  EXPECT_THAT(topics->difference(channel("i1")), IsEmpty());
}

TEST_F(SplitTopicsTest, WhatIsNotReadAnyMoreNeedNotAgree) {
  const auto topics = spout();
  topics->follow(channel("i1"), topic("x"));
  topics->follow(channel("i2"), topic("y"));
  broker_->tell("x", 4);
  next_changes(*topics);
  agreement_->set(source(), "side", split(2));
  topics->forget(channel("i2"), topic("y"));
  EXPECT_THAT(agreement_->difference(source()), HasSubstr("4 partitions")) << "the other instance's topic is read";
  topics->forget(channel("i1"), topic("x"));
  EXPECT_THAT(agreement_->difference(source()), IsEmpty());
}

TEST_F(SplitTopicsTest, TwoTopicsOfOneDriverAreNotTakenForEachOther) {
  // One instance was moved to a topic of its own, with fewer partitions, and so was its other channel.
  const auto topics = spout();
  topics->follow(channel("i1"), topic("x"));
  topics->follow(channel("i2"), topic("y", "another kafka"));
  broker_->tell("x", 4);
  next_changes(*topics);
  broker_->tell("y", 2);
  next_changes(*topics);
  agreement_->set(source("i1"), "side", split(4));  // as another spout of the worker does
  agreement_->set(source("i2"), "side", split(2));
  EXPECT_THAT(topics->difference(channel("i1")), IsEmpty());
  EXPECT_THAT(topics->difference(channel("i2")), IsEmpty());

  agreement_->set(source("i1"), "side", split(2));
  EXPECT_THAT(topics->difference(channel("i1")), HasSubstr("\"side\" and \"up\" have 2 and 4 partitions"));
  EXPECT_THAT(topics->difference(channel("i2")), IsEmpty());
  topics->forget(channel("i1"), topic("x"));
  EXPECT_THAT(topics->difference(channel("i1")), IsEmpty()) << "that topic is not read any more";
}

TEST_F(SplitTopicsTest, AnInstanceThatComesToAKnownTopicIsJudgedAtOnce) {
  const auto topics = spout();
  topics->follow(channel("i1"), topic("x"));
  broker_->tell("x", 4);
  next_changes(*topics);
  agreement_->set(source("i2"), "side", split(2));
  EXPECT_THAT(topics->difference(channel("i2")), IsEmpty());
  EXPECT_EQ(topics->follow(channel("i2"), topic("x")), 4);
  EXPECT_THAT(topics->difference(channel("i2")), HasSubstr("have 2 and 4 partitions"));
}

TEST_F(SplitTopicsTest, ASharedTopicThatIsNotSplitMeetsTopicsOfOnePartitionOnly) {
  broker_->split_nothing();
  const auto topics = spout();
  EXPECT_EQ(topics->follow(channel("i1"), topic("x")), std::nullopt);
  agreement_->set(source(), "side", split(1));  // as another spout of the worker does
  EXPECT_THAT(topics->difference(channel("i1")), IsEmpty());
  agreement_->set(source(), "side", split(4));
  EXPECT_TRUE(next_changes(*topics).all);
  EXPECT_THAT(topics->difference(channel("i1")),
              AllOf(HasSubstr("side: shared and split into 4 partitions; up: shared and not split"),
                    HasSubstr("channel.NAME.broker"), HasSubstr("a \"group\" of its own")));
}

TEST_F(SplitTopicsTest, AnExclusiveChannelMeetsExclusiveChannelsOnly) {
  const auto topics = spout();
  auto own = channel("i1");
  own.shared = false;
  EXPECT_EQ(topics->follow(own, topic("x")), std::nullopt);
  EXPECT_FALSE(broker_->is_followed("x")) << "nothing splits it";
  agreement_->set(source(), "side", {.exclusive = true, .partitions = {}});
  EXPECT_THAT(topics->difference(own), IsEmpty());
  agreement_->set(source(), "side", {});
  EXPECT_TRUE(next_changes(*topics).all);
  EXPECT_THAT(topics->difference(own),
              AllOf(HasSubstr("side: shared and not split; up: exclusive"), HasSubstr("channel.NAME.shared")));
  topics->forget(own, topic("x"));
  EXPECT_THAT(agreement_->difference(source()), IsEmpty());
}

TEST_F(SplitTopicsTest, ABrokerThatCannotBeUsedSaysNothingOfItsTopics) {
  const auto topics = spout();
  topics->follow(channel("i1"), topic("x", "unknown"));
  agreement_->set(source(), "side", split(4));
  EXPECT_THAT(topics->difference(channel("i1")), IsEmpty());
}

TEST_F(SplitTopicsTest, AtItsEndItFollowsNothingAndTellsOfNothing) {
  const auto topics = spout();
  topics->follow(channel("i1"), topic("x"));
  broker_->tell("x", 4);
  next_changes(*topics);
  topics->end();
  EXPECT_FALSE(broker_->is_followed("x"));
  agreement_->set(source(), "side", split(2));
  EXPECT_THAT(agreement_->difference(source()), IsEmpty()) << "its own number is gone";
  agreement_->set(source(), "other", split(3));
  EXPECT_EQ(changes_, expected_);
}

}  // namespace
}  // namespace iotcloud::topology
