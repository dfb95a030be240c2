#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/topology/worker/broker_watch.h>

namespace iotcloud::topology {
namespace {

using brokers::ConnectionState;
using namespace std::chrono_literals;

class BrokerWatchTest : public testing::Test {
 protected:
  double away(const std::string& broker) const {
    for (const auto& sample : metrics_.collect()) {
      if (sample.name == "iotcloud_broker_away" && sample.labels.at("broker") == broker) return sample.value;
    }
    return -1;
  }
  tests::HandClock clock_;
  config::Metrics metrics_;
  std::vector<BrokerWatch::Link> links_{{"rabbitmq", "amqp://one/", ConnectionState::connected, 0},
                                        {"kafka", "kafka://two", ConnectionState::connecting, 0}};
  BrokerWatch watch_{[this] { return links_; }, clock_, metrics_, {{"topology", "t"}}};
};

TEST_F(BrokerWatchTest, SaysWhichBrokersAreAwayAndForHowLong) {
  EXPECT_EQ(watch_.trouble(), "") << "it may be connecting for a moment";
  const auto since = clock_.wall_ms();
  clock_.advance(5s);
  links_[1].why = "connection refused";
  EXPECT_THAT(watch_.trouble(), testing::MatchesRegex("the broker kafka \\(kafka://two\\) is away since "
                                                      "[-0-9]+T[:0-9]+Z: connection refused \\(start its server, or "
                                                      "correct `brokers`\\)"));
  EXPECT_EQ(watch_.look().at(1).since_ms, since);
  EXPECT_EQ(away("kafka"), 1);
  EXPECT_EQ(away("rabbitmq"), 0);
  links_[0].state = ConnectionState::blocked;
  links_[1].state = ConnectionState::connected;
  EXPECT_EQ(watch_.trouble(), "");
  clock_.advance(3s);
  EXPECT_THAT(watch_.trouble(), testing::StartsWith("the broker rabbitmq (amqp://one/) takes no messages since "));
  EXPECT_EQ(away("kafka"), 0);
}

TEST_F(BrokerWatchTest, ATimeOfDayThatIsSetBackHidesNoTrouble) {
  EXPECT_EQ(watch_.trouble(), "");
  clock_.set_wall_ms(clock_.wall_ms() - 3'600'000);
  clock_.advance(5s);
  EXPECT_THAT(watch_.trouble(), testing::StartsWith("the broker kafka (kafka://two) is away since "));
}

TEST_F(BrokerWatchTest, ABrokerThatIsNotUsedAnyMoreIsNoTrouble) {
  static_cast<void>(watch_.look());
  links_.pop_back();
  clock_.advance(5s);
  EXPECT_EQ(watch_.trouble(), "");
  EXPECT_EQ(away("kafka"), 0);
}

}  // namespace
}  // namespace iotcloud::topology
