// Gateways that do not come back.
#include <optional>

#include <gmock/gmock.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using test::FakeGateway;
using test::TestMaster;
using testing::HasSubstr;

class MasterForget : public testing::Test {
 protected:
  MasterForget() { EXPECT_TRUE(master.leads()); }
  OrderResult forget(const std::string& gateways) {
    return master->give("forgetGateway", R"({"gateways":[)" + gateways + "]}").result;
  }
  OrderResult deploy(const std::string& name) {
    DeployRequest request;
    request.plugin = "turtle.so";
    request.name = name;
    return master->deploy(request);
  }

  const std::string url = test::fresh_registry_url();
  const std::unique_ptr<discovery::Registry> registry = test::open_registry(url);
  const discovery::Paths paths;
  TestMaster master{url};
};

TEST_F(MasterForget, ALostGatewayIsRemovedWithItsOrdersAndRecordsAndNoOrderToAllWaitsForItAnyMore) {
  FakeGateway here(url, "lab1");
  {
    FakeGateway gone(url, "lab2");
    const auto deployed = deploy("robot");
    ASSERT_TRUE(deployed.all_done()) << deployed.summary();
  }
  ASSERT_TRUE(tests::eventually([&] { return !registry->get(paths.gateway_alive("lab2"_gateway)); }));
  EXPECT_FALSE(deploy("second").all_done()) << "lab2 is lost, so its part is pending";

  const auto result = forget(R"("lab2")");
  EXPECT_TRUE(result.all_done()) << result.summary();
  EXPECT_THAT(result.outcomes.at(0).reason, HasSubstr("2 order(s)"));
  EXPECT_FALSE(registry->get(paths.gateway("lab2"_gateway)));
  for (const auto& driver : discovery::list_drivers(*registry, paths)) EXPECT_EQ(driver.gateway, "lab1");
  const auto third = deploy("third");
  EXPECT_TRUE(third.all_done()) << third.summary();
  EXPECT_EQ(third.outcomes.size(), 1U);
}

TEST_F(MasterForget, WhatIsOrderedOfALostGatewayIsListedUntilItIsTakenAway) {
  std::optional<FakeGateway> gone(std::in_place, url, "lab2");
  ASSERT_TRUE(deploy("robot").all_done());
  gone.reset();
  ASSERT_TRUE(tests::eventually([&] { return !registry->get(paths.gateway_alive("lab2"_gateway)); }));
  EXPECT_EQ(master->drivers_and_lost_orders().size(), 1U) << "what the gateway has reported is not listed twice";
  const auto ordered = deploy("second").outcomes.at(0).instance;
  const auto all = master->drivers_and_lost_orders();
  ASSERT_EQ(all.size(), 2U);
  EXPECT_EQ(all.back().instance, ordered);
  EXPECT_EQ(all.back().deployment, "second");
  EXPECT_EQ(all.back().name, "turtle");
  EXPECT_EQ(all.back().state, discovery::DriverState::ordered);
  EXPECT_THAT(all.back().reason, HasSubstr("its gateway is lost"));
  InstanceSelection selection;
  selection.instances = {ordered};
  static_cast<void>(master->undeploy(selection));
  EXPECT_EQ(master->drivers_and_lost_orders().size(), 1U);
}

TEST_F(MasterForget, AGatewayThatIsAliveIsNotForgotten) {
  FakeGateway here(url, "lab1");
  const auto result = forget(R"("lab1")");
  EXPECT_EQ(result.outcomes.at(0).outcome, OrderOutcome::failed);
  EXPECT_THAT(result.outcomes.at(0).reason, HasSubstr("it is alive"));
  EXPECT_TRUE(registry->get(paths.gateway("lab1"_gateway)));
}

TEST_F(MasterForget, WhatIsNotThereIsRefused) {
  EXPECT_EQ(forget(R"("nowhere")").refusal, OrderRefusal::unknown_gateway);
  EXPECT_EQ(forget("").refusal, OrderRefusal::bad_request);
}

}  // namespace
}  // namespace iotcloud::master
