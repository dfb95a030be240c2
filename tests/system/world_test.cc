#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/system/pinger.h>
#include <iotcloud/topology/testing/world.h>

namespace iotcloud::tests {
namespace {

using drivers::Direction;
using topology::testing::FakeInstance;
using topology::testing::World;
using topology::testing::WorldOptions;

constexpr const char* echo = R"(
topology.name: echo
spouts:
  ping: {broker: rabbitmq, driver: pinger, channel: ping, fields: [text, driverID, time]}
bolts:
  pong: {broker: rabbitmq, driver: pinger, channel: pong, fields: [text, driverID, time], inputs: {from: ping}}
)";

drivers::ChannelSpec channel(const std::string& name, Direction direction) {
  drivers::ChannelSpec spec;
  spec.name = name;
  spec.direction = direction;
  return spec;
}

WorldOptions with_fakes() {
  return {.fakes = {{"pinger", {channel("ping", Direction::out), channel("pong", Direction::in)}}}};
}

std::vector<std::string> texts(const std::vector<drivers::Message>& messages) {
  std::vector<std::string> all;
  for (const auto& message : messages) all.emplace_back(message.payload.text());
  return all;
}

std::string refusal(const std::function<void()>& call) {
  try {
    call();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "nothing was thrown";
}

TEST(ATestsWorld, BringsEachAnswerToTheInstanceThatAsked) {
  World world(with_fakes());
  world.run_text(echo, "echo.yaml");
  FakeInstance& first = world.add("pinger");
  FakeInstance& second = world.add("pinger");
  for (int i = 0; i < 100; ++i) first.publish("ping", std::to_string(i));
  second.publish("ping", "of the second");
  EXPECT_EQ(first.wait_for("pong", 100).size(), 100u);
  EXPECT_EQ(texts(first.received("pong")).back(), "99");
  EXPECT_THAT(texts(second.wait_for("pong", 1)), ::testing::ElementsAre("of the second"));
  EXPECT_EQ(second.received("pong")[0].driver_id, second.id());
  EXPECT_TRUE(world.stop());
}

TEST(ATestsWorld, IsSeenByNoOtherWorld) {
  World one(with_fakes()), other(with_fakes());
  one.run_text(echo, "echo.yaml");
  FakeInstance& deaf = other.add("pinger");
  deaf.publish("ping", "nobody reads");
  FakeInstance& heard = one.add("pinger");
  heard.publish("ping", "read");
  EXPECT_EQ(heard.wait_for("pong", 1).size(), 1u);
  EXPECT_THAT(deaf.received("pong"), ::testing::IsEmpty());
}

TEST(ATestsWorld, RunsARealDriverBesideFakes) {
  WorldOptions options;
  options.drivers = {{"pinger", Pinger::descriptor()}};
  World world(std::move(options));
  world.run_text(echo, "echo.yaml");
  EXPECT_TRUE(Answers::get().wait_for(world.deploy("pinger", {{"count", "5"}}), 5));
}

TEST(ATestsWorld, SaysWhichChannelsAndDriversThereAre) {
  World world(with_fakes());
  FakeInstance& pinger = world.add("pinger");
  EXPECT_EQ(refusal([&] { pinger.publish("pong", "x"); }),
            "the driver \"pinger\" of this world has no outgoing channel \"pong\"; it has: ping");
  EXPECT_EQ(refusal([&] { pinger.received("pnog"); }),
            "the driver \"pinger\" of this world has no incoming channel \"pnog\"; it has: pong");
  EXPECT_EQ(refusal([&] { world.add("piger"); }), "the world's option `fakes` has no driver \"piger\"");
}

TEST(ATestsWorld, RefusesToSendForAnInstanceThatWasTakenAway) {
  World world(with_fakes());
  FakeInstance& pinger = world.add("pinger");
  world.undeploy(pinger.id());
  EXPECT_THAT(refusal([&] { pinger.publish("ping", "x"); }), ::testing::HasSubstr("is not there any more"));
}

}  // namespace
}  // namespace iotcloud::tests
