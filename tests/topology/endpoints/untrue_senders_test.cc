// Messages that name another sender than their channel has: what the thief of a gateway may send, and to whom it leads.
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/endpoints/receiving/sender_filter.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using namespace std::chrono_literals;

/// The instance `mine` is on gateway-1, whose credentials are stolen, the instance `victim` on gateway-2. The topology
/// answers each message to the instance that sent it.
class UntrueSenders : public Endpoints {
 protected:
  void show(const std::string& instance, const std::string& gateway, bool shared = false) {
    for (const bool up : {true, false}) {
      auto channel =
          channel_record(instance, up ? "up" : "down", up ? discovery::Direction::out : discovery::Direction::in);
      channel.properties = {{"routingKey", channel.name}};
      channel.gateway = discovery::GatewayId(gateway);
      channel.shared = shared && up;
      put_channel(channel);
    }
    auto driver = driver_record(instance);
    driver.gateway = discovery::GatewayId(gateway);
    put_driver(driver);
  }
  std::unique_ptr<brokers::Publisher> writer(const std::string& topic) {
    return broker_->publisher({"", topic, false}, many());
  }
  /// Waits until the topology has heard of all that was written before: of a driver that comes after it.
  void until_heard() {
    const std::string name = "later" + std::to_string(++later_);
    Mailbox to_it(*broker_, "g.d." + name + ".down");
    show(name, "g");
    const auto it = writer("g.d." + name + ".up");
    it->publish(message("x", name));
    ASSERT_TRUE(to_it.wait_for(1));
  }
  bool reads(double channels) {
    return eventually([&] { return metric("iotcloud_spout_channels") == channels; });
  }
  double refused(const std::string& reason) const {
    double sum = 0;
    for (const auto& sample : metrics_.collect()) {
      if (sample.name == "iotcloud_spout_untrue_senders_total" && sample.labels.at("reason") == reason)
        sum += sample.value;
    }
    return sum;
  }

  int later_ = 0;
  Mailbox to_mine_{*broker_, "gateway-1.d.mine.down"};
  Mailbox to_victim_{*broker_, "gateway-2.d.victim.down"};
};

TEST_F(UntrueSenders, OnAnExclusiveChannelLeadToNoOtherInstance) {
  const tests::CapturedLog log;
  show("mine", "gateway-1");
  show("victim", "gateway-2");
  run();
  ASSERT_TRUE(reads(2));
  const auto thief = writer("gateway-1.d.mine.up");
  thief->publish(message("drive\nfast", "victim"));
  auto of_its_gateway = message("drive", "victim");
  of_its_gateway.gateway_id = "gateway-2";
  thief->publish(of_its_gateway);
  thief->publish(message("mine", "mine"));
  ASSERT_TRUE(to_mine_.wait_for(1));
  writer("gateway-2.d.victim.up")->publish(message("true", "victim"));
  ASSERT_TRUE(to_victim_.wait_for(1));
  EXPECT_THAT(to_victim_.texts(), ElementsAre("true"));
  EXPECT_THAT(to_mine_.texts(), ElementsAre("mine"));
  EXPECT_EQ(refused("other_instance"), 1);
  EXPECT_EQ(refused("other_gateway"), 1);
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 2);
  EXPECT_THAT(log.text(), HasSubstr("a message of gateway-1.d.mine.up is not believed and is rejected: it says that it "
                                    "is from instance \"victim\", but it came on a channel of instance mine on gateway "
                                    "gateway-1"));
  EXPECT_EQ(log.text().find("from gateway \"gateway-2\""), std::string::npos) << "one line for both";
  EXPECT_TRUE(eventually([&] {
    return brokers::embedded::Server::named(url_.substr(11)).depth("gateway-1.d.mine.up", "t") == 0;
  })) << "they would come again";
}

TEST_F(UntrueSenders, OnASharedChannelLeadToNoInstanceOfAnotherGateway) {
  show("mine", "gateway-1", true);
  show("victim", "gateway-2", true);
  run();
  ASSERT_TRUE(reads(2));
  const auto thief = writer("gateway-1.d.up");
  thief->publish(message("drive", "victim"));
  auto of_its_gateway = message("drive", "victim");
  of_its_gateway.gateway_id = "gateway-2";
  thief->publish(of_its_gateway);
  thief->publish(message("mine", "mine"));
  ASSERT_TRUE(to_mine_.wait_for(1));
  writer("gateway-2.d.up")->publish(message("true", "victim"));
  ASSERT_TRUE(to_victim_.wait_for(1));
  EXPECT_THAT(to_victim_.texts(), ElementsAre("true"));
  EXPECT_EQ(refused("other_gateway"), 2);
}

TEST_F(UntrueSenders, OnASharedChannelLeadToNoInstanceThatTheRegistryHasNotToldOf) {
  show("mine", "gateway-1", true);
  run();
  ASSERT_TRUE(reads(1));
  const auto thief = writer("gateway-1.d.up");
  thief->publish(message("drive", "victim"));
  thief->publish(message("mine", "mine"));
  ASSERT_TRUE(to_mine_.wait_for(1)) << "another one's message does not wait";
  show("victim", "gateway-2", true);
  ASSERT_TRUE(eventually([&] { return refused("other_gateway") == 1; }));
  thief->publish(message("drive", "nobody"));
  ASSERT_TRUE(eventually([&] { return refused("unknown_instance") == 1; }));
  EXPECT_THAT(to_victim_.texts(), IsEmpty());
}

/// What SECURITY.md says that a driver host reaches, and all of its gateway's.
TEST_F(UntrueSenders, OnASharedChannelAreBelievedInTheNameOfAnotherInstanceOfTheSameGateway) {
  show("mine", "gateway-1", true);
  show("fellow", "gateway-1", true);
  run();
  Mailbox to_fellow(*broker_, "gateway-1.d.fellow.down");
  ASSERT_TRUE(reads(1));
  writer("gateway-1.d.up")->publish(message("drive", "fellow"));
  ASSERT_TRUE(to_fellow.wait_for(1));
  EXPECT_THAT(to_fellow.texts(), ElementsAre("drive"));
  EXPECT_EQ(metric("iotcloud_spout_untrue_senders_total"), 0);
}

TEST_F(UntrueSenders, GoToTheDeadLettersInTheNameOfTheirChannel) {
  show("mine", "gateway-1");
  show("victim", "gateway-2");
  Mailbox letters(*broker_, "letters", true);
  run("{deadLetter: letters}");
  ASSERT_TRUE(reads(2));
  writer("gateway-1.d.mine.up")->publish(message("drive", "victim"));
  ASSERT_TRUE(letters.wait_for(1));
  EXPECT_EQ(letters.message(0).payload.text(), "drive");
  EXPECT_EQ(letters.message(0).driver_id, "mine");
  EXPECT_EQ(letters.message(0).gateway_id, "gateway-1");
  EXPECT_THAT(*letters.message(0).properties.find("dead-letter-reason"), HasSubstr("from instance \"victim\""));
  EXPECT_TRUE(eventually([&] { return metric("iotcloud_spout_dead_letters_total") == 1; }));
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 0);
}

TEST_F(UntrueSenders, AreRefusedWithAutomaticAcknowledgementToo) {
  show("mine", "gateway-1");
  show("victim", "gateway-2");
  run("{ackMode: auto}");
  ASSERT_TRUE(reads(2));
  const auto thief = writer("gateway-1.d.mine.up");
  thief->publish(message("drive", "victim"));
  thief->publish(message("mine", "mine"));
  ASSERT_TRUE(to_mine_.wait_for(1));
  EXPECT_THAT(to_victim_.texts(), IsEmpty());
  EXPECT_EQ(refused("other_instance"), 1);
}

TEST_F(UntrueSenders, AreNotThoseThatNameNobodyAsSomeProgramsOfTheOriginalDo) {
  show("mine", "gateway-1");
  run();
  ASSERT_TRUE(reads(1));
  writer("gateway-1.d.mine.up")->publish(message("x", ""));
  ASSERT_TRUE(to_mine_.wait_for(1));
  EXPECT_EQ(to_mine_.message(0).driver_id, "mine");
  EXPECT_EQ(to_mine_.message(0).gateway_id, "gateway-1");
  EXPECT_EQ(metric("iotcloud_spout_untrue_senders_total"), 0);
}

/// Records that the thief of gateway-1 puts below its own instance.
using UntrueRecords = UntrueSenders;

TEST_F(UntrueRecords, LeadNoCommandsOfAnotherInstanceToTheThief) {
  show("victim", "gateway-2");
  run();
  ASSERT_TRUE(reads(1));
  const auto victim = writer("gateway-2.d.victim.up");
  victim->publish(message("1", "victim"));
  ASSERT_TRUE(to_victim_.wait_for(1));
  show("mine", "gateway-1");
  ASSERT_TRUE(reads(2));
  Mailbox thief(*broker_, "gateway-1.d.victim.down");
  auto untrue = channel_record("victim", "down", discovery::Direction::in);
  untrue.properties = {{"routingKey", "down"}};
  untrue.gateway = "gateway-1"_gateway;
  const std::string path = paths_.channel("d"_driver, "mine"_instance, "down");
  discovery::put(*registry_, path, discovery::encode(untrue));
  until_heard();
  victim->publish(message("2", "victim"));
  ASSERT_TRUE(to_victim_.wait_for(2));
  EXPECT_THAT(thief.texts(), IsEmpty());
  registry_->remove(path);  // which took the victim's route away, too
  until_heard();
  victim->publish(message("3", "victim"));
  ASSERT_TRUE(to_victim_.wait_for(3));
  EXPECT_EQ(metric("iotcloud_bolt_unknown_driver_total"), 0);
}

TEST_F(UntrueRecords, HaveNothingReadInTheNameOfAnotherInstance) {
  show("victim", "gateway-2");
  run();
  ASSERT_TRUE(reads(1));
  show("mine", "gateway-1");
  ASSERT_TRUE(reads(2));
  auto untrue = channel_record("victim", "up", discovery::Direction::out);
  untrue.properties = {{"routingKey", "up"}};
  untrue.gateway = "gateway-1"_gateway;
  discovery::put(*registry_, paths_.channel("d"_driver, "mine"_instance, "up"), discovery::encode(untrue));
  ASSERT_TRUE(reads(1)) << "that of the thief is not read any more, that of the victim still is";
  writer("gateway-1.d.victim.up")->publish(message("drive", "victim"));
  writer("gateway-2.d.victim.up")->publish(message("true", "victim"));
  ASSERT_TRUE(to_victim_.wait_for(1));
  EXPECT_THAT(to_victim_.texts(), ElementsAre("true"));
}

/// What SECURITY.md says that whoever can write a channel's record chooses.
TEST_F(UntrueRecords, ChooseTheTopicBelowTheInstancesOwnNamesAndWithoutUsersTheAddress) {
  show("mine", "gateway-1");
  run();
  ASSERT_TRUE(reads(1));
  brokers::BrokerOptions of_thief;
  of_thief.urls = {url_ + "-of-the-thief"};
  const auto elsewhere = brokers::make_broker(of_thief);
  Mailbox commands(*elsewhere, "gateway-1.d.mine.other");
  auto untrue = channel_record("mine", "down", discovery::Direction::in);
  untrue.gateway = "gateway-1"_gateway;
  untrue.properties = {{"routingKey", "other"}};
  untrue.broker_url = of_thief.urls.front();
  put_channel(untrue);
  until_heard();
  writer("gateway-1.d.mine.up")->publish(message("drive", "mine"));
  ASSERT_TRUE(commands.wait_for(1));
  EXPECT_THAT(to_mine_.texts(), IsEmpty());
}

/// What the filter does with the messages of a shared channel of gateway-1, at times that the test says.
class WaitingSenders : public testing::Test {
 protected:
  WaitingSenders() {
    brokers::BrokerOptions to;
    to.urls = {"embedded://waiting-senders"};
    reader_ = TopicReader::open(brokers::make_broker(to), {"local", to.urls}, {"", "gateway-1.d.up", false}, {},
                                {"gateway-1"_gateway, {}}, std::make_shared<SpoutQueue>(10, SpoutWaker()),
                                std::make_shared<StandstillFence>(), std::make_shared<HeldMessages>());
  }
  ~WaitingSenders() override {
    filter_.clear();
    reader_->close();
  }
  SenderFilter::Passed pass(const std::string& instance) {
    brokers::Message message;
    message.driver_id = instance;
    return filter_.pass(ChannelMessage(brokers::Delivery(std::move(message), false, nullptr, 0), reader_), now_);
  }
  /// Whether a message of this instance has to wait.
  bool waits(const std::string& instance) { return !pass(instance).arrival; }
  std::string refusal_of_next() { return filter_.next(now_).refusal; }

  config::Metrics metrics_;
  bool away_ = false;  ///< the registry
  const std::shared_ptr<KnownInstances> known_ = std::make_shared<KnownInstances>([this] { return !away_; });
  SenderFilter filter_{known_, false, metrics_, {}};
  std::shared_ptr<TopicReader> reader_;
  config::Clock::Instant now_{1h};
};

TEST_F(WaitingSenders, AreRefusedWhenTheRegistryDoesNotTellOfThemInTime) {
  EXPECT_TRUE(waits("nobody"));
  now_ += SenderFilter::grace - 1ms;
  EXPECT_FALSE(filter_.next(now_).arrival);
  now_ += 1ms;
  EXPECT_THAT(refusal_of_next(), AllOf(HasSubstr("\"nobody\""), HasSubstr("which the registry does not have")));
  EXPECT_TRUE(filter_.empty());
}

TEST_F(WaitingSenders, WaitOnWhileTheRegistryStillTellsOfOthersAsAtTheStart) {
  EXPECT_TRUE(waits("late"));
  for (int second = 0; second < 20; ++second) {
    known_->told(discovery::InstanceId("other" + std::to_string(second)), "gateway-1"_gateway, true);
    EXPECT_FALSE(filter_.next(now_).arrival) << second;
    now_ += 1s;
  }
  known_->told("late"_instance, "gateway-1"_gateway, true);
  const auto passed = filter_.next(now_);
  ASSERT_TRUE(passed.arrival);
  EXPECT_EQ(passed.refusal, "");
  EXPECT_EQ(passed.arrival->delivery.message.gateway_id, "gateway-1");
}

TEST_F(WaitingSenders, DoNotWaitForEver) {
  EXPECT_TRUE(waits("nobody"));
  for (int second = 0; second < 30; ++second) {
    known_->told(discovery::InstanceId("other" + std::to_string(second)), "gateway-1"_gateway, true);
    EXPECT_FALSE(filter_.next(now_).arrival) << second;
    now_ += 1s;
  }
  EXPECT_NE(refusal_of_next(), "");
}

TEST_F(WaitingSenders, WaitAsLongAsTheRegistryIsAwayAndThenAMoment) {
  EXPECT_TRUE(waits("nobody"));
  now_ += SenderFilter::grace;
  EXPECT_NE(refusal_of_next(), "");
  away_ = true;
  EXPECT_TRUE(waits("nobody")) << "it may have been deployed since";
  EXPECT_TRUE(waits("new"));
  for (int minute = 0; minute < 60; ++minute) {
    now_ += 1min;
    EXPECT_FALSE(filter_.next(now_).arrival) << minute;
  }
  away_ = false;
  known_->told("new"_instance, "gateway-1"_gateway, true);
  const auto passed = filter_.next(now_);
  ASSERT_TRUE(passed.arrival);
  EXPECT_EQ(passed.arrival->delivery.message.driver_id, "new");
  EXPECT_EQ(passed.refusal, "");
  now_ += SenderFilter::grace - 1ms;
  EXPECT_FALSE(filter_.next(now_).arrival);
  now_ += 1ms;
  EXPECT_THAT(refusal_of_next(), HasSubstr("\"nobody\""));
}

TEST_F(WaitingSenders, DoNotKeepTheSpoutFromReadingWhenManyCameWhileTheRegistryIsAway) {
  away_ = true;
  for (std::size_t i = 0; i < SenderFilter::most_waiting; ++i) EXPECT_TRUE(waits("nobody" + std::to_string(i)));
  EXPECT_TRUE(filter_.full());
  now_ += SenderFilter::grace;
  for (std::size_t i = 0; i < SenderFilter::most_waiting; ++i) ASSERT_NE(refusal_of_next(), "") << i;
  EXPECT_TRUE(filter_.empty());
  EXPECT_NE(pass("nobody0").refusal, "");
}

TEST_F(WaitingSenders, DoNotWaitEachWhenOneHasWaitedInVain) {
  EXPECT_TRUE(waits("gone"));
  now_ += SenderFilter::grace;
  EXPECT_NE(refusal_of_next(), "");
  for (int i = 0; i < 1000; ++i) ASSERT_NE(pass("gone").refusal, "");
  EXPECT_TRUE(waits("new"));
  now_ += SenderFilter::nobody_for;
  EXPECT_TRUE(waits("gone")) << "it may be deployed again";
}

TEST_F(WaitingSenders, PassAtOnceWhenTheRegistryHasToldOfThemAlsoBeforeTheyWent) {
  known_->told("one"_instance, "gateway-1"_gateway, true);
  EXPECT_FALSE(waits("one"));
  known_->gone("one"_instance);
  const auto passed = pass("one");
  ASSERT_TRUE(passed.arrival);
  EXPECT_EQ(passed.refusal, "");
}

TEST_F(WaitingSenders, PassWhenTheyNameNobodyAndNothingIsChosen) {
  const auto passed = pass("");
  ASSERT_TRUE(passed.arrival);
  EXPECT_EQ(passed.refusal, "");
  EXPECT_EQ(passed.arrival->delivery.message.driver_id, "");
}

}  // namespace
}  // namespace iotcloud::topology
