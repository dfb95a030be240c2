// The open channels of an instance, as its driver and people use them, with the in-process broker.
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/brokers/embedded/server.h>
#include <iotcloud/gateway/host/open_channels.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::gateway {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using tests::eventually;

class OpenChannelsTest : public ::testing::Test {
 protected:
  OpenChannelsTest() : url_(std::string("embedded://") + name()), server_(brokers::embedded::Server::named(name())) {
    environment_.clock = &config::system_clock();
    environment_.metrics = &metrics_;
    environment_.brokers = std::make_unique<brokers::BrokerPool>(nullptr, &metrics_);
  }

  static std::string name() { return ::testing::UnitTest::GetInstance()->current_test_info()->name(); }
  static drivers::Message message(const std::string& text) {
    drivers::Message message;
    message.payload = brokers::Payload::copy(text);
    return message;
  }
  PlannedChannel plan(const std::string& channel, drivers::Direction direction) const {
    PlannedChannel plan;
    plan.spec.name = channel;
    plan.spec.direction = direction;
    plan.topic = {"", "gw.probe.1." + channel, false};
    plan.address = {"embedded", {url_}};
    plan.record.name = channel;
    plan.record.driver = "probe"_driver;
    plan.record.direction = direction == drivers::Direction::out ? discovery::Direction::out : discovery::Direction::in;
    return plan;
  }
  void open_outgoing(const std::string& channel) {
    const PlannedChannel planned = plan(channel, drivers::Direction::out);
    channels_.add_outgoing(
        planned, std::make_unique<OutgoingChannel>(environment_, "1"_instance, planned, OutgoingChannel::Events{}));
  }
  /// \param handled what the driver does with each message
  std::shared_ptr<ChannelQueue> open_incoming(const std::string& channel, ChannelQueue::Handled handled) {
    const PlannedChannel planned = plan(channel, drivers::Direction::in);
    auto queue =
        std::make_shared<ChannelQueue>(loop_, 0, metrics_.counter("superseded", "", {}),
                                       [handled](brokers::Message&&, config::Clock::Instant) { return handled; });
    channels_.add_incoming(planned, environment_.brokers->get(planned.address, planned.broker), queue,
                           std::make_shared<ChannelLooks>(*environment_.clock));
    return queue;
  }
  discovery::ChannelLook look(const std::string& channel) const {
    discovery::LookRequest request;
    request.channel = channel;
    request.look = "a";
    request.most = 10;
    request.bytes = 100;
    discovery::ChannelLook answer;
    answer.state = "active";
    channels_.look(request, answer);
    return answer;
  }
  /// Hands a message over and returns its outcome.
  std::string hand(const std::string& channel) {
    // Shared with the callback, which the queue may keep for longer than this call.
    struct Answer {
      std::atomic<bool> came{false};
      std::string problem;
    };
    const auto answer = std::make_shared<Answer>();
    channels_.hand(channel, message("by hand"), [answer](const std::string& problem) {
      answer->problem = problem;
      answer->came = true;
    });
    return eventually([&] { return answer->came.load(); }) ? answer->problem : "nobody answered";
  }

  std::string url_;
  brokers::embedded::Server server_;
  config::Metrics metrics_;
  HostEnvironment environment_;
  std::shared_ptr<EventLoop> loop_ = std::make_shared<EventLoop>("test");
  OpenChannels channels_{environment_, "1"_instance};
};

TEST_F(OpenChannelsTest, AMessageForAChannelThatIsNotOpenStaysWithItsSender) {
  open_outgoing("data");
  open_incoming("control", ChannelQueue::Handled::done);
  auto sent = message("a");
  EXPECT_EQ(channels_.publish("dat", sent), std::nullopt);
  EXPECT_EQ(channels_.publish("control", sent), std::nullopt) << "it is incoming";
  EXPECT_EQ(sent.payload.text(), "a");
  EXPECT_EQ(channels_.publish("data", sent), drivers::PublishStatus::accepted);
  EXPECT_THAT(channels_.outgoing_names(), ElementsAre("data"));
}

TEST_F(OpenChannelsTest, ALookSaysWhatChannelsThereAreAndShowsWhatPassesOnOne) {
  open_outgoing("data");
  open_incoming("control", ChannelQueue::Handled::done);
  EXPECT_THAT(look("data").messages, IsEmpty()) << "the look begins here";
  auto sent = message("a");
  channels_.publish("data", sent);
  const auto seen = look("data");
  EXPECT_EQ(seen.problem, "");
  ASSERT_EQ(seen.messages.size(), 1U);
  EXPECT_EQ(seen.messages[0].payload, "a");
  ASSERT_EQ(seen.channels.size(), 2U);
  EXPECT_EQ(seen.channels[1].name, "data");
  EXPECT_EQ(seen.channels[1].waiting, 1) << "nobody reads the topic";
  EXPECT_EQ(look("control").problem, "");
  EXPECT_THAT(look("dat").problem,
              HasSubstr("instance 1 has no channel \"dat\"; it has \"control\" (in), \"data\" (out)"));
}

TEST_F(OpenChannelsTest, WhoHandsAMessageOverIsToldWhatBecameOfIt) {
  open_outgoing("data");
  open_incoming("control", ChannelQueue::Handled::done);
  open_incoming("broken", ChannelQueue::Handled::failed);
  const auto ending = open_incoming("ending", ChannelQueue::Handled::not_taken);
  EXPECT_EQ(hand("control"), "");
  EXPECT_THAT(hand("broken"), HasSubstr("the driver failed on the message"));
  EXPECT_THAT(hand("data"), HasSubstr("\"data\" of instance 1 is outgoing"));
  EXPECT_THAT(hand("contro"), HasSubstr("has no channel \"contro\""));
  ending->close();
  EXPECT_THAT(hand("ending"), HasSubstr("the instance ended before its driver saw the message"));
}

TEST_F(OpenChannelsTest, ALookSaysWhatBecameOfTheMessages) {
  open_incoming("control", ChannelQueue::Handled::done);
  open_incoming("broken", ChannelQueue::Handled::failed);
  hand("control");
  hand("control");
  hand("broken");
  const auto channels = look("control").channels;
  ASSERT_EQ(channels.size(), 2U);
  EXPECT_EQ(channels[0].done, 0);
  EXPECT_EQ(channels[0].lost.at("failed: the driver threw"), 1);
  EXPECT_EQ(channels[1].done, 2);
  EXPECT_THAT(channels[1].lost, IsEmpty());
  std::int64_t lost = 0;
  channels_.each_tally([&](const auto&, const ChannelTally& tally) { lost += tally.losses().messages; });
  EXPECT_EQ(lost, 1);
}

TEST_F(OpenChannelsTest, HiddenChannelsCanBeWrittenToUntilTheyAreTaken) {
  open_outgoing("data");
  channels_.hide();
  EXPECT_THAT(look("data").problem, HasSubstr("instance 1 is active and has no open channel"));
  int found = 0;
  channels_.each_backlog([&](const auto&, const auto&) { ++found; });
  EXPECT_EQ(found, 0);
  auto sent = message("a");
  EXPECT_EQ(channels_.publish("data", sent), drivers::PublishStatus::accepted);
  const auto taken = channels_.take_outgoing();
  EXPECT_EQ(taken.size(), 1U);
  EXPECT_EQ(taken.at("data")->backlog().waiting, 1U);
  EXPECT_EQ(channels_.publish("data", sent), std::nullopt);
}

}  // namespace
}  // namespace iotcloud::gateway
