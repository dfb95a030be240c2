#include <gmock/gmock.h>

#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::DriverState;
using test::FakeGateway;
using test::TestMaster;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

class MasterDrain : public testing::Test {
 protected:
  MasterDrain() { EXPECT_TRUE(master.leads()); }
  std::string deploy(const std::string& gateway) {
    DeployRequest request;
    request.plugin = "turtle.so";
    request.gateways = {discovery::GatewayId(gateway)};
    return master->deploy(request).outcomes.at(0).instance;
  }
  DriverState state(const std::string& instance) {
    for (const auto& driver : master->drivers()) {
      if (driver.instance == instance) return driver.state;
    }
    return DriverState::undeployed;
  }
  static GatewaySelection lab1() { return {{"lab1"_gateway}, {}}; }
  static InstanceSelection only(const std::string& instance) { return {{discovery::InstanceId(instance)}, {}, {}}; }

  const std::string url = test::fresh_registry_url();
  TestMaster master{url};
};

TEST_F(MasterDrain, StopsWhatRunsAndUndrainStartsThatAgain) {
  FakeGateway gateway(url, "lab1");
  const auto ran = deploy("lab1");
  const auto stopped = deploy("lab1");
  ASSERT_TRUE(master->stop(only(stopped)).all_done());

  const auto drained = master->drain(lab1());
  ASSERT_TRUE(drained.all_done()) << drained.summary();
  EXPECT_THAT(drained.outcomes, SizeIs(1)) << "the other one was stopped before";
  EXPECT_EQ(state(ran), DriverState::inactive);
  EXPECT_TRUE(master->gateways().at(0).draining);

  const auto back = master->undrain(lab1());
  ASSERT_TRUE(back.all_done()) << back.summary();
  EXPECT_EQ(state(ran), DriverState::active);
  EXPECT_EQ(state(stopped), DriverState::inactive);
  EXPECT_FALSE(master->gateways().at(0).draining);
}

TEST_F(MasterDrain, ADeploymentToAllPassesItByAndOneThatNamesItIsRefused) {
  FakeGateway first(url, "lab1");
  FakeGateway second(url, "lab2");
  ASSERT_TRUE(master->drain(lab1()).all_done());
  DeployRequest request;
  request.plugin = "turtle.so";
  const auto all = master->deploy(request);
  ASSERT_THAT(all.outcomes, SizeIs(1));
  EXPECT_EQ(all.outcomes[0].gateway, "lab2");
  request.gateways = {"lab2"_gateway, "lab1"_gateway};
  const auto named = master->deploy(request);
  EXPECT_EQ(named.refusal, OrderRefusal::bad_request);
  EXPECT_THAT(named.text, HasSubstr("iotcloud undrain lab1"));
  EXPECT_THAT(first.orders(), IsEmpty());
  EXPECT_THAT(second.orders(), SizeIs(1));
  ASSERT_TRUE(master->drain({{"lab2"_gateway}, {}}).all_done());
  request.gateways.clear();
  EXPECT_THAT(master->deploy(request).text, HasSubstr("all gateways are draining"));
}

TEST_F(MasterDrain, WhatIsStartedMeanwhileStartsAfterwardsAndWhatIsStoppedDoesNot) {
  FakeGateway gateway(url, "lab1");
  const auto one = deploy("lab1");
  const auto two = deploy("lab1");
  ASSERT_TRUE(master->stop(only(one)).all_done());
  ASSERT_TRUE(master->drain(lab1()).all_done());
  const auto later = master->start(only(one));
  EXPECT_EQ(later.outcomes.at(0).outcome, OrderOutcome::pending);
  EXPECT_THAT(later.outcomes.at(0).reason, HasSubstr("iotcloud undrain lab1"));
  EXPECT_EQ(state(one), DriverState::inactive);
  ASSERT_TRUE(master->stop(only(two)).all_done());
  ASSERT_TRUE(master->undrain(lab1()).all_done());
  EXPECT_EQ(state(one), DriverState::active);
  EXPECT_EQ(state(two), DriverState::inactive);
}

TEST_F(MasterDrain, OutlivesTheMasterAndTheGateway) {
  const auto kept = test::open_registry(url);  // which ends with its last session
  std::string instance;
  {
    FakeGateway gateway(url, "lab1");
    instance = deploy("lab1");
    ASSERT_TRUE(master->drain(lab1()).all_done());
  }
  master.end();
  FakeGateway gateway(url, "lab1");
  TestMaster next(url);
  ASSERT_TRUE(next.leads());
  EXPECT_TRUE(next->gateways().at(0).draining);
  ASSERT_TRUE(gateway.wait_for_orders(1));
  EXPECT_FALSE(gateway.orders().at(0).active) << "a gateway that starts again starts nothing";
  const auto back = next->undrain(lab1());
  ASSERT_TRUE(back.all_done()) << back.summary();
  EXPECT_EQ(back.outcomes.at(0).instance, instance);
}

TEST_F(MasterDrain, MayBeRepeatedAndFinishesWhatWasBegun) {
  FakeGateway gateway(url, "lab1");
  const auto instance = deploy("lab1");
  gateway.behave(FakeGateway::say_nothing());
  const auto begun = master->drain({{"lab1"_gateway}, std::chrono::milliseconds(1)});
  EXPECT_EQ(begun.outcomes.at(0).outcome, OrderOutcome::unknown);
  ASSERT_TRUE(test::eventually([&] { return gateway.orders_seen() == 2; }));  // or it would obey this one too
  gateway.behave(FakeGateway::obey);
  EXPECT_THAT(master->drain(lab1()).outcomes, IsEmpty()) << "it is ordered already";
  EXPECT_TRUE(master->gateways().at(0).draining);
  EXPECT_TRUE(master->undrain(lab1()).all_done());
  EXPECT_THAT(master->undrain(lab1()).outcomes, IsEmpty());
  EXPECT_EQ(state(instance), DriverState::active);
}

TEST_F(MasterDrain, AnInstanceThatHadFailedIsNotWaitedFor) {
  FakeGateway gateway(url, "lab1");
  const auto instance = deploy("lab1");
  gateway.behave(FakeGateway::say_nothing());
  gateway.report(instance, DriverState::failed, "no");
  const auto drained = master->drain(lab1());
  EXPECT_EQ(drained.outcomes.at(0).outcome, OrderOutcome::done);
  EXPECT_THAT(drained.outcomes.at(0).reason, HasSubstr("failed before"));
}

TEST_F(MasterDrain, ALostGatewayDrainsWhenItComesBack) {
  std::string instance;
  {
    FakeGateway gateway(url, "lab1");
    instance = deploy("lab1");
  }
  ASSERT_TRUE(test::eventually([&] { return !master->gateways().at(0).alive; }));
  EXPECT_EQ(master->drain(lab1()).outcomes.at(0).outcome, OrderOutcome::pending);
  FakeGateway gateway(url, "lab1");
  EXPECT_TRUE(test::eventually([&] { return state(instance) == DriverState::inactive; }));
}

TEST_F(MasterDrain, WantsGatewaysThatThereAre) {
  FakeGateway gateway(url, "lab1");
  EXPECT_EQ(master->drain({{"lab7"_gateway}, {}}).refusal, OrderRefusal::unknown_gateway);
  EXPECT_EQ(master->drain({}).refusal, OrderRefusal::bad_request);
  EXPECT_FALSE(master->gateways().at(0).draining);
}

}  // namespace
}  // namespace iotcloud::master
