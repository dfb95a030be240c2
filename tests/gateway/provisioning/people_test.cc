// What people order by a master about instances that a gateway's rules make.
#include <string>

#include <gmock/gmock.h>

#include <iotcloud/tests/gateway/provisioning/provisioning_fixture.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using discovery::InstanceId;
using ::testing::HasSubstr;
using ::testing::SizeIs;

class ProvisioningMasterTest : public ProvisioningGatewayTest {
 protected:
  ProvisioningMasterTest() {
    EXPECT_TRUE(master_.leads());
    start("1h");
    TestFinder::find("7");
    EXPECT_TRUE(comes_to(id("p-7"), DriverState::active));
  }
  master::OrderResult change(master::InstanceAction action, const std::string& name = "p-7") {
    const master::InstanceSelection selection{{InstanceId(id(name))}, {}, std::chrono::seconds(60)};
    switch (action) {
      case master::InstanceAction::start:
        return master_->start(selection);
      case master::InstanceAction::stop:
        return master_->stop(selection);
      case master::InstanceAction::undeploy:
        break;
    }
    return master_->undeploy(selection);
  }
  master::DeployRequest same_name() const {
    master::DeployRequest request;
    request.plugin = "probe.so";
    request.name = "p-7";
    request.gateways = {"gw"_gateway};
    request.properties = {{"says", "who=master"}};
    return request;
  }

  master::test::TestMaster master_{registry_url_};
};

TEST_F(ProvisioningMasterTest, stop_start_and_undeploy_hold_until_a_person_starts_it) {
  using master::InstanceAction;
  auto result = change(InstanceAction::stop);
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(record(id("p-7"))->state, DriverState::inactive);
  result = change(InstanceAction::start);
  ASSERT_TRUE(result.all_done()) << result.summary();
  result = change(InstanceAction::undeploy);
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_FALSE(record(id("p-7")));
  TestFinder::with([](auto& context) { context.report_gone("7"); });
  TestFinder::find("7");
  TestFinder::find("8");
  ASSERT_TRUE(comes_to(id("p-8"), DriverState::active)) << "the gateway has heard of the other one since";
  EXPECT_FALSE(record(id("p-7")));
  result = change(InstanceAction::undeploy);
  EXPECT_THAT(result.outcomes.at(0).reason, HasSubstr("iotcloud start"));
  result = change(InstanceAction::start);
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(record(id("p-7"))->made_by, "rule probes");
}

TEST_F(ProvisioningMasterTest, a_deployment_of_the_same_name_takes_it_over_and_gives_it_back) {
  auto result = master_->deploy(same_name());
  ASSERT_TRUE(result.all_done()) << result.summary();
  ASSERT_THAT(result.outcomes, SizeIs(1));
  EXPECT_EQ(result.outcomes[0].instance, id("p-7"));
  EXPECT_TRUE(eventually([&] {
    auto now = record(id("p-7"));
    return now && now->made_by.empty() && now->metadata["who"] == "master";
  }));
  result = change(master::InstanceAction::undeploy);
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_TRUE(eventually([&] {
    const auto now = record(id("p-7"));
    return now && now->made_by == "rule probes" && now->state == DriverState::active;
  })) << "the rule counts again";
}

TEST_F(ProvisioningMasterTest, a_deployment_takes_over_what_a_person_has_undeployed) {
  ASSERT_TRUE(change(master::InstanceAction::undeploy).all_done());
  const auto result = master_->deploy(same_name());
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(record(id("p-7"))->made_by, "");
}

TEST_F(ProvisioningMasterTest, other_orders_say_whose_it_is) {
  const auto result = master_->update_metadata({{InstanceId(id("p-7"))}, {}, std::chrono::seconds(60)}, {{"a", "b"}});
  EXPECT_FALSE(result.all_done());
  EXPECT_THAT(result.outcomes.at(0).reason, HasSubstr("rule probes of its gateway made it"));
}

TEST_F(ProvisioningMasterTest, a_drained_gateway_stops_it_and_starts_it_again) {
  auto result = master_->drain({{"gw"_gateway}, std::chrono::seconds(60)});
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(record(id("p-7"))->state, DriverState::inactive);
  result = master_->undrain({{"gw"_gateway}, std::chrono::seconds(60)});
  ASSERT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(record(id("p-7"))->state, DriverState::active);
}

}  // namespace
}  // namespace iotcloud::gateway
