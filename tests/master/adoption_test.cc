// Gateways that are frozen, because the registry was emptied or put back to an earlier state, and what a master says.
#include <gmock/gmock.h>

#include <iotcloud/discovery/freeze.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using test::FakeGateway;
using test::TestMaster;
using testing::HasSubstr;

class MasterAdopt : public testing::Test {
 protected:
  MasterAdopt() { EXPECT_TRUE(master.leads()); }
  std::string mark(const std::string& gateway) const {
    return discovery::freeze_path(paths, discovery::GatewayId(gateway));
  }
  void freeze(const std::string& gateway) {
    discovery::put(*registry, mark(gateway),
                   encode(discovery::FreezeRecord{"it was emptied", 5, "token of " + gateway}));
  }
  /// Acts as a frozen gateway does when somebody adopts the registry.
  discovery::GuardPtr thaws(const std::string& gateway) {
    const auto list = paths.orders(discovery::GatewayId(gateway));
    return registry->watch_node(list, [this, gateway, list](const auto& node) {
      if (!node || node->data.empty()) return;
      if (discovery::decode_adoption(node->data, list).token == "token of " + gateway) registry->remove(mark(gateway));
    });
  }
  OrderResult adopt(const std::string& gateways) {
    return master->give("adopt", R"({"gateways":[)" + gateways + "]}").result;
  }

  const std::string url = test::fresh_registry_url();
  const std::unique_ptr<discovery::Registry> registry = test::open_registry(url);
  const discovery::Paths paths;
  TestMaster master{url};
};

TEST_F(MasterAdopt, AFrozenGatewayIsListedWithItsReason) {
  FakeGateway gateway(url, "lab1");
  EXPECT_EQ(master->gateways().at(0).frozen, "");
  freeze("lab1");
  EXPECT_EQ(master->gateways().at(0).frozen, "it was emptied");
  discovery::put(*registry, mark("lab1"), "{");
  EXPECT_EQ(master->gateways().at(0).frozen, "it does not say why");
}

TEST_F(MasterAdopt, AGatewayHearsThatTheOrdersAreMeant) {
  FakeGateway gateway(url, "lab1");
  freeze("lab1");
  const auto gateways_part = thaws("lab1");
  const auto result = adopt(R"("lab1")");
  EXPECT_TRUE(result.all_done()) << result.summary();
  const auto list = paths.orders("lab1"_gateway);
  EXPECT_GT(discovery::decode_adoption(registry->get(list)->data, list).epoch, 0);
  EXPECT_EQ(master->gateways().at(0).frozen, "");
}

TEST_F(MasterAdopt, WithoutANameItIsForAllThatAreFrozen) {
  FakeGateway first(url, "lab1"), second(url, "lab2"), third(url, "lab3");
  freeze("lab1");
  freeze("lab3");
  const auto one = thaws("lab1"), three = thaws("lab3");
  const auto result = adopt("");
  EXPECT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(result.outcomes.size(), 2U);
}

TEST_F(MasterAdopt, WhatIsNotFrozenIsLeftAloneAndWhatIsNotThereIsRefused) {
  FakeGateway gateway(url, "lab1");
  const auto result = adopt(R"("lab1")");
  EXPECT_TRUE(result.all_done());
  EXPECT_THAT(result.outcomes.at(0).reason, HasSubstr("not frozen"));
  EXPECT_EQ(adopt(R"("nowhere")").refusal, OrderRefusal::unknown_gateway);
}

TEST_F(MasterAdopt, OrdersForAFrozenGatewayArePendingAlsoThoseOfWhatItRuns) {
  FakeGateway gateway(url, "lab1");
  DeployRequest request;
  request.plugin = "turtle.so";
  request.name = "robot";
  request.gateways = {"lab1"_gateway};
  const auto deployed = master->deploy(request);
  ASSERT_TRUE(deployed.all_done()) << deployed.summary();
  const auto instance = deployed.outcomes.at(0).instance;
  EXPECT_THAT(master->deploy(request).outcomes.at(0).reason, HasSubstr("deployed so already"));
  gateway.behave(FakeGateway::say_nothing());
  freeze("lab1");
  discovery::DriverRecord runs = master->drivers().at(0);
  registry->remove(paths.order("lab1"_gateway, instance));
  discovery::put(*registry, paths.instance(runs.name, instance), encode(runs));
  const auto again = master->deploy(request).outcomes.at(0);
  EXPECT_EQ(again.outcome, OrderOutcome::pending) << again.reason;
  EXPECT_THAT(again.reason, HasSubstr("frozen"));
  EXPECT_EQ(again.instance, instance);
}

TEST_F(MasterAdopt, AGatewayThatIsSilentIsUnknown) {
  FakeGateway gateway(url, "lab1");
  freeze("lab1");
  const auto result = master->give("adopt", R"({"gateways":["lab1"],"wait_ms":1})").result;
  EXPECT_EQ(result.outcomes.at(0).outcome, OrderOutcome::unknown);
}

}  // namespace
}  // namespace iotcloud::master
