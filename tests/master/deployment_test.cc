// Instances with names, and what they were deployed with.
#include <set>

#include <gmock/gmock.h>

#include <iotcloud/discovery/instance_name.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::DriverState;
using test::FakeGateway;
using test::TestMaster;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

using Texts = std::map<std::string, std::string>;

DeployRequest meter(std::vector<std::string> gateways = {"lab1"}, int count = 1) {
  DeployRequest request;
  request.plugin = "meter.so";
  request.name = "meter";
  request.gateways = {gateways.begin(), gateways.end()};
  request.count = count;
  return request;
}

class MasterDeployments : public testing::Test {
 protected:
  MasterDeployments() { EXPECT_TRUE(master.leads()); }
  std::vector<discovery::InstanceId> instances(const OrderResult& result) const {
    std::vector<discovery::InstanceId> ids;
    for (const auto& outcome : result.outcomes) ids.push_back(outcome.instance);
    return ids;
  }

  const std::string url = test::fresh_registry_url();
  TestMaster master{url};
};

TEST_F(MasterDeployments, NameNumberAndGatewayMakeTheId) {
  EXPECT_EQ(discovery::named_instance_id("lab1"_gateway, "meter", 1),
            discovery::named_instance_id("lab1"_gateway, "meter", 1));
  const std::set<discovery::InstanceId> ids{discovery::named_instance_id("lab1"_gateway, "meter", 1),
                                            discovery::named_instance_id("lab2"_gateway, "meter", 1),
                                            discovery::named_instance_id("lab1"_gateway, "metre", 1),
                                            discovery::named_instance_id("lab1"_gateway, "meter", 2)};
  EXPECT_THAT(ids, SizeIs(4));
  for (const auto& id : ids) EXPECT_THAT(id.str(), SizeIs(32));

  FakeGateway gateway(url, "lab1");
  const auto result = master->deploy(meter({"lab1"}, 2));
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(result.outcomes.at(1).instance, discovery::named_instance_id("lab1"_gateway, "meter", 2));
  for (const auto& driver : master->drivers()) EXPECT_EQ(driver.deployment, "meter");
  EXPECT_EQ(master->orders().at(0).gateway, "lab1");
}

TEST_F(MasterDeployments, WhatIsThereIsNotDeployedTwice) {
  FakeGateway gateway(url, "lab1");
  ASSERT_TRUE(master->deploy(meter()).all_done());
  const auto again = master->deploy(meter({"lab1"}, 2));
  ASSERT_THAT(again.outcomes, SizeIs(2));
  EXPECT_TRUE(again.all_done()) << again.summary();
  EXPECT_EQ(again.outcomes[0].reason, "unchanged: it is deployed so already");
  EXPECT_THAT(gateway.orders(), SizeIs(2));
}

TEST_F(MasterDeployments, WhatIsThereAndDiffersOrHasFailedIsNotCalledUnchanged) {
  FakeGateway gateway(url, "lab1");
  ASSERT_TRUE(master->deploy(meter()).all_done());
  auto other = meter();
  other.properties["rate"] = "4711";
  const auto differs = master->deploy(other);
  EXPECT_EQ(differs.outcomes.at(0).outcome, OrderOutcome::failed);
  EXPECT_THAT(differs.outcomes[0].reason, AllOf(HasSubstr("meter 1"), HasSubstr("already, and differs")));
  gateway.report(differs.outcomes[0].instance.str(), discovery::DriverState::failed, "no device");
  EXPECT_EQ(master->deploy(meter()).outcomes.at(0).outcome, OrderOutcome::failed);
}

TEST_F(MasterDeployments, AnInstanceThatIsNotGoneYetIsNotDeployedAgain) {
  FakeGateway gateway(url, "lab1");
  const auto deployed = master->deploy(meter());
  gateway.behave(FakeGateway::say_nothing());
  master->undeploy({instances(deployed), {}, std::chrono::milliseconds(1)});
  const auto again = master->deploy(meter());
  EXPECT_EQ(again.outcomes.at(0).outcome, OrderOutcome::failed);
  EXPECT_THAT(again.outcomes.at(0).reason, HasSubstr("still being undeployed"));
  EXPECT_THAT(master->orders(), IsEmpty());
}

TEST_F(MasterDeployments, NumbersMayBeNamedAndAnInstanceMayWaitToBeStarted) {
  FakeGateway gateway(url, "lab1");
  auto request = meter();
  request.indexes = {7, 3};
  request.active = false;
  request.manager = "lab";
  const auto result = master->deploy(request);
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(result.outcomes.at(0).instance, discovery::named_instance_id("lab1"_gateway, "meter", 3));
  for (const auto& driver : master->drivers()) EXPECT_EQ(driver.state, DriverState::inactive);
  EXPECT_EQ(master->orders().at(0).order.manager, "lab");
}

TEST_F(MasterDeployments, NamesThatCannotBeAreRefused) {
  FakeGateway gateway(url, "lab1");
  auto request = meter();
  request.name = "a/b";
  EXPECT_EQ(master->deploy(request).refusal, OrderRefusal::bad_request);
  request = meter();
  request.indexes = {0};
  EXPECT_EQ(master->deploy(request).refusal, OrderRefusal::bad_request);
  request = meter();
  request.name = "";
  request.manager = "lab";
  EXPECT_EQ(master->deploy(request).refusal, OrderRefusal::bad_request);
  EXPECT_EQ(gateway.orders_seen(), 0);
}

TEST_F(MasterDeployments, OtherPropertiesMakeInstancesAnewUnderTheirIds) {
  FakeGateway gateway(url, "lab1");
  const auto ids = instances(master->deploy(meter()));
  const auto result = master->change_deployment({ids, Texts{{"rate", "9"}}, "lab", {}});
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(master->orders().at(0).order.properties.at("rate"), "9");
  EXPECT_EQ(master->orders().at(0).order.manager, "lab");
  EXPECT_EQ(master->drivers().at(0).instance, ids.at(0));
}

TEST_F(MasterDeployments, AChangeIsNotDoneBeforeTheInstanceWasMadeAnew) {
  FakeGateway gateway(url, "lab1");
  const auto ids = instances(master->deploy(meter()));
  gateway.behave(FakeGateway::say_nothing());
  const auto result = master->change_deployment({ids, Texts{{"rate", "9"}}, {}, std::chrono::milliseconds(50)});
  EXPECT_EQ(result.outcomes.at(0).outcome, OrderOutcome::unknown) << "the record still says active, of the life before";
}

TEST_F(MasterDeployments, AnInstanceThatDoesNotComeUpWithItsNewPropertiesHasFailed) {
  FakeGateway gateway(url, "lab1");
  const auto ids = instances(master->deploy(meter()));
  gateway.behave(FakeGateway::fail("rate is no number"));
  const auto result = master->change_deployment({ids, Texts{{"rate", "x"}}, {}, {}});
  EXPECT_EQ(result.outcomes.at(0).outcome, OrderOutcome::failed);
  EXPECT_EQ(result.outcomes.at(0).reason, "rate is no number");
}

TEST_F(MasterDeployments, WhatDoesNotDifferIsDoneAtOnce) {
  FakeGateway gateway(url, "lab1");
  const auto ids = instances(master->deploy(meter()));
  gateway.behave(FakeGateway::say_nothing());
  EXPECT_TRUE(master->change_deployment({ids, Texts{}, "lab", {}}).all_done());
  EXPECT_EQ(master->change_deployment({ids, {}, {}, {}}).refusal, OrderRefusal::bad_request);
}

}  // namespace
}  // namespace iotcloud::master
