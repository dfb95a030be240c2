#include <gmock/gmock.h>

#include <iotcloud/brokers/broker.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using Metadata = std::map<std::string, std::string>;

/// What a driver says of itself, on its way into its record.
class DriverMetadata : public GatewayFixture {
 protected:
  bool says(const std::string& instance, const Metadata& expected) {
    return eventually([&] {
      const auto now = record(instance);
      return now && now->state == DriverState::active && now->metadata == expected;
    });
  }
  /// Lets the driver say it while it runs.
  void let_say(const std::string& instance, const std::string& pair) {
    brokers::BrokerOptions options;
    options.urls = {broker_url_};
    const auto broker = brokers::make_broker(options);
    const auto control = broker->publisher({"probe", "gw.probe." + instance + ".control", false}, {});
    brokers::Message message;
    message.payload = brokers::Payload::copy("say " + pair);
    control->publish(std::move(message));
    EXPECT_TRUE(control->drain(std::chrono::seconds(20)));
  }
};

TEST_F(DriverMetadata, StandsInTheRecordWithThatOfTheOrderAndGoesBeforeIt) {
  start_gateway();
  auto wanted = order("a", {{"says", "battery=90"}});
  wanted.metadata = {{"site", "lab"}, {"battery", "100"}};
  give(wanted);
  EXPECT_TRUE(says("a", {{"site", "lab"}, {"battery", "90"}}));
  wanted.metadata = {{"site", "roof"}};
  give(wanted);
  EXPECT_TRUE(says("a", {{"site", "roof"}, {"battery", "90"}}));
}

TEST_F(DriverMetadata, ChangesWhileTheDriverRunsAndNothingElseIsWritten) {
  start_gateway();
  give(order("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  const auto channel = [&] { return registry_->get(paths_.channel("probe"_driver, "a"_instance, "control"))->version; };
  const auto before = channel();
  const auto since = record("a")->since_ms;
  for (int round = 0; round < 5; ++round) {
    let_say("a", "position=" + std::to_string(round) + ",0");
    EXPECT_TRUE(says("a", {{"position", std::to_string(round) + ",0"}}));
  }
  let_say("a", "position=");
  EXPECT_TRUE(says("a", {}));
  EXPECT_EQ(channel(), before);
  EXPECT_EQ(record("a")->since_ms, since);
}

TEST_F(DriverMetadata, IsRefusedWhenItIsTooMuchAndTheRestStands) {
  start_gateway();
  give(order("a", {{"says", "battery=90"}}));
  ASSERT_TRUE(says("a", {{"battery", "90"}}));
  let_say("a", "novel=" + std::string(20'000, 'x'));
  let_say("a", "battery=80");
  EXPECT_TRUE(says("a", {{"battery", "80"}}));
}

TEST_F(DriverMetadata, OfAnInstanceThatFailsStaysAndOfItsNextLifeBeginsAnew) {
  auto slow = options();
  slow.restart.first = std::chrono::hours(1);  // the state stays to be seen
  gateway_.emplace(std::move(slow));
  gateway_->start();
  give(order("a", {{"says", "battery=90"}, {"throw_in", "message"}}));
  ASSERT_TRUE(says("a", {{"battery", "90"}}));
  let_say("a", "battery=1");
  ASSERT_TRUE(comes_to("a", DriverState::failed));
  EXPECT_EQ(record("a")->metadata, (Metadata{{"battery", "90"}}));
  give(order("a"));
  EXPECT_TRUE(says("a", {}));
}

}  // namespace
}  // namespace iotcloud::gateway
