// Rolling updates: one step after the other, and back again when one does not come off.
#include <algorithm>
#include <future>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::DriverState;
using discovery::OrderRecord;
using test::FakeGateway;
using test::TestMaster;
using testing::AllOf;
using testing::Each;
using testing::HasSubstr;
using testing::SizeIs;

const std::string v1(64, '1');
const std::string v2(64, '2');

class Update : public testing::Test {
 protected:
  Update() { EXPECT_TRUE(master.leads()); }

  /// \return the ids, in the order of the gateways.
  std::vector<discovery::InstanceId> deploy(int count, std::vector<std::string> gateways) {
    DeployRequest request;
    request.gateways = {gateways.begin(), gateways.end()};
    request.plugin = "turtle.so";
    request.sha256 = v1;
    request.driver = "turtle"_driver;
    request.properties = {{"rate", "5"}};
    request.metadata = {{"site", "lab"}};
    request.count = count;
    const auto result = master->deploy(request);
    EXPECT_TRUE(result.all_done()) << result.summary();
    std::vector<discovery::InstanceId> ids;
    for (const auto& outcome : result.outcomes) ids.push_back(outcome.instance);
    return ids;
  }
  OrderResult update(const std::vector<discovery::InstanceId>& ids, int at_once = 0, WaitLimit wait = {},
                     const std::string& sha256 = v2) {
    UpdateRequest request;
    request.selection.instances = ids;
    request.selection.wait = wait;
    request.plugin = "turtle-2.so";
    request.sha256 = sha256;
    request.at_once = at_once;
    return master->update(request);
  }
  OrderRecord order(const FakeGateway& gateway, const discovery::InstanceId& id) {
    const auto path = paths.order(gateway.id(), id);
    return discovery::decode_order(master.registry().get(path)->data, path);
  }
  /// Does the first version, and fails with every other.
  static FakeGateway::Behaviour refuse_v2() {
    return [](const OrderRecord& order) {
      return order.sha256 == v2 ? FakeGateway::Report{DriverState::failed, "its plugin is broken"}
                                : *FakeGateway::obey(order);
    };
  }

  const std::string url = test::fresh_registry_url();
  const discovery::Paths paths;
  TestMaster master{url};
};

TEST_F(Update, InstancesRunTheNewVersionAndKeepAllElse) {
  FakeGateway lab1(url, "lab1"), lab2(url, "lab2");
  const auto ids = deploy(2, {"lab1", "lab2"});
  const auto before = order(lab1, ids[0]);
  const auto result = update(ids);
  EXPECT_TRUE(result.all_done()) << result.summary();
  ASSERT_THAT(result.outcomes, SizeIs(4));
  auto expected = before;
  expected.plugin = "turtle-2.so";
  expected.sha256 = v2;
  EXPECT_EQ(order(lab1, ids[0]), expected) << "the version before is not named any more, all else is as it was";
  for (const auto& driver : master->drivers()) EXPECT_EQ(driver.sha256, v2);
}

TEST_F(Update, OtherPropertiesComeToThoseThatAreNamedAndTheOthersKeepTheirs) {
  FakeGateway lab1(url, "lab1"), lab2(url, "lab2");
  const auto ids = deploy(1, {"lab1", "lab2"});
  UpdateRequest request;
  request.selection.instances = ids;
  request.properties = {{ids[1], {{"rate", "7"}}}};
  const auto before = order(lab2, ids[1]);
  const auto result = master->update(request);
  EXPECT_TRUE(result.all_done()) << result.summary();
  auto expected = before;
  expected.properties = {{"rate", "7"}};
  EXPECT_EQ(order(lab2, ids[1]), expected) << "its plugin stays, and no version before is named";
  EXPECT_EQ(order(lab1, ids[0]).properties.at("rate"), "5");
  request = {};
  request.selection.instances = ids;
  EXPECT_EQ(master->update(request).refusal, OrderRefusal::bad_request) << "it gives neither plugin nor properties";
}

TEST_F(Update, OtherPropertiesGoBackWhereAnInstanceDoesNotComeUpWithThem) {
  FakeGateway lab1(url, "lab1"), lab2(url, "lab2");
  const auto ids = deploy(1, {"lab1", "lab2"});
  lab2.behave([](const OrderRecord& order) {
    return order.properties.at("rate") == "7" ? FakeGateway::Report{DriverState::failed, "too fast"}
                                              : *FakeGateway::obey(order);
  });
  UpdateRequest request;
  request.selection.instances = ids;
  for (const bool with_plugin : {false, true}) {
    request.plugin = with_plugin ? "turtle-2.so" : "";
    request.sha256 = with_plugin ? v2 : "";
    request.properties = {{ids[0], {{"rate", "7"}}}, {ids[1], {{"rate", "7"}}}};
    const auto result = master->update(request);
    EXPECT_THAT(
        result.outcomes[1].reason,
        AllOf(HasSubstr(with_plugin ? "back on turtle.so" : "back on its former properties"), HasSubstr("too fast")));
    EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::failed);
    for (const auto* gateway : {&lab1, &lab2}) {
      const auto now = order(*gateway, gateway == &lab1 ? ids[0] : ids[1]);
      EXPECT_EQ(now.properties.at("rate"), "5");
      EXPECT_EQ(now.sha256, v1);
      EXPECT_FALSE(now.previous);
    }
  }
}

TEST_F(Update, OneGatewayComesAfterTheOther) {
  FakeGateway lab1(url, "lab1"), lab2(url, "lab2");
  const auto ids = deploy(1, {"lab1", "lab2"});
  lab1.behave(FakeGateway::say_nothing());
  auto running = std::async(std::launch::async, [&] { return update(ids); });
  ASSERT_TRUE(test::eventually([&] { return order(lab1, ids[0]).sha256 == v2; }));
  EXPECT_EQ(order(lab1, ids[0]).previous, (discovery::PluginVersion{"turtle.so", v1}));
  EXPECT_EQ(order(lab2, ids[1]).sha256, v1) << "the first has not come up yet";
  lab1.behave(FakeGateway::obey);
  ASSERT_TRUE(test::eventually([&] { return lab1.orders().at(0).sha256 == v2; }));
  lab1.report(ids[0], DriverState::active);
  const auto result = running.get();
  EXPECT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(order(lab2, ids[1]).sha256, v2);
}

TEST_F(Update, OtherPropertiesComeToOneGatewayAfterTheOther) {
  FakeGateway lab1(url, "lab1"), lab2(url, "lab2");
  const auto ids = deploy(1, {"lab1", "lab2"});
  lab1.behave(FakeGateway::say_nothing());
  UpdateRequest request;
  request.selection.instances = ids;
  request.properties = {{ids[0], {{"rate", "7"}}}, {ids[1], {{"rate", "7"}}}};
  auto running = std::async(std::launch::async, [&] { return master->update(request); });
  const auto rate_at = [](const FakeGateway& gateway) { return gateway.orders().at(0).properties.at("rate"); };
  ASSERT_TRUE(test::eventually([&] { return rate_at(lab1) == "7"; }));
  EXPECT_EQ(order(lab2, ids[1]).properties.at("rate"), "5") << "the first has not come up yet";
  lab1.behave(FakeGateway::obey);
  lab1.report(ids[0], DriverState::active);
  const auto result = running.get();
  EXPECT_TRUE(result.all_done()) << result.summary();
  EXPECT_EQ(order(lab2, ids[1]).properties.at("rate"), "7");
}

TEST_F(Update, SoManyAtOnceAreUpdatedInOneStep) {
  FakeGateway lab1(url, "lab1");
  const auto ids = deploy(5, {"lab1"});
  lab1.behave(FakeGateway::say_nothing());
  auto running = std::async(std::launch::async, [&] { return update(ids, 2); });
  const auto ordered = [&] {
    const auto orders = lab1.orders();
    return std::count_if(orders.begin(), orders.end(), [](const auto& one) { return one.sha256 == v2; });
  };
  for (const int step : {2, 4, 5}) {
    ASSERT_TRUE(test::eventually([&] { return ordered() == step; }));
    for (const auto& one : lab1.orders()) {
      if (one.sha256 == v2) lab1.report(one.instance, DriverState::active);
    }
  }
  const auto result = running.get();
  EXPECT_TRUE(result.all_done()) << result.summary();
}

TEST_F(Update, WhenOneFailsAllGoBackAndTheOutcomesSaySo) {
  FakeGateway lab1(url, "lab1"), lab2(url, "lab2", refuse_v2()), lab3(url, "lab3");
  const auto ids = deploy(1, {"lab1", "lab2", "lab3"});
  const auto before = order(lab1, ids[0]);
  const auto untouched = lab3.orders_seen();
  const auto result = update(ids);
  EXPECT_EQ(result.refusal, OrderRefusal::none);
  EXPECT_FALSE(result.all_done());
  ASSERT_THAT(result.outcomes, SizeIs(3));
  EXPECT_THAT(result.outcomes, Each(testing::Field(&InstanceOutcome::outcome, OrderOutcome::failed)));
  EXPECT_THAT(result.outcomes[0].reason, AllOf(HasSubstr("back on turtle.so (111111111111)"), HasSubstr("lab2"),
                                               HasSubstr("its plugin is broken")));
  EXPECT_THAT(result.outcomes[1].reason, AllOf(HasSubstr("back on turtle.so"), HasSubstr("its plugin is broken")));
  EXPECT_THAT(result.outcomes[2].reason, HasSubstr("not begun"));
  EXPECT_EQ(order(lab1, ids[0]), before);
  for (const auto& driver : master->drivers()) {
    EXPECT_EQ(driver.sha256, v1);
    EXPECT_EQ(driver.state, DriverState::active);
  }
  EXPECT_EQ(lab3.orders_seen(), untouched);
}

TEST_F(Update, OneThatDoesNotComeUpInTimeGoesBack) {
  FakeGateway lab1(url, "lab1", [](const OrderRecord& order) -> std::optional<FakeGateway::Report> {
    if (order.sha256 == v2) return FakeGateway::Report{DriverState::starting, "its driver host crashed"};
    return FakeGateway::obey(order);
  });
  const auto ids = deploy(1, {"lab1"});
  // Time enough for the gateway's word on the new plugin, and for going back.
  std::string reason;
  for (std::chrono::milliseconds limit{300}; limit < test::patience; limit *= 2) {
    const auto result = update(ids, 0, limit);
    EXPECT_FALSE(result.all_done());
    reason = result.outcomes[0].reason;
    if (reason.find("back on turtle.so") != std::string::npos && reason.find("crashed") != std::string::npos) break;
  }
  EXPECT_THAT(reason, AllOf(HasSubstr("back on turtle.so"), HasSubstr("its driver host crashed")));
  EXPECT_EQ(order(lab1, ids[0]).sha256, v1);
}

TEST_F(Update, OneThatComesUpAndFallsOverGoesBack) {
  FakeGateway lab1(url, "lab1");
  const auto ids = deploy(1, {"lab1"});
  auto running = std::async(std::launch::async, [&] {
    UpdateRequest request;
    request.selection.instances = ids;
    request.plugin = "turtle-2.so";
    request.sha256 = v2;
    request.settle = test::patience;
    return master->update(request);
  });
  ASSERT_TRUE(test::eventually([&] { return lab1.orders().at(0).sha256 == v2; }));
  // Up and down until the update has seen it up, and then down.
  const auto ends_within = [&](std::chrono::milliseconds limit) {
    return running.wait_for(limit) == std::future_status::ready;
  };
  ASSERT_TRUE(test::eventually([&] {
    lab1.report(ids[0], DriverState::active);
    if (ends_within(std::chrono::milliseconds{50})) return true;
    lab1.report(ids[0], DriverState::starting, "its driver host crashed");
    return ends_within(std::chrono::milliseconds{400});
  }));
  const auto result = running.get();
  EXPECT_FALSE(result.all_done());
  EXPECT_THAT(result.outcomes[0].reason, AllOf(HasSubstr("back on turtle.so"), HasSubstr("did not stay so"),
                                               HasSubstr("its driver host crashed")));
}

TEST_F(Update, WhatCannotGoBackEitherIsSaid) {
  FakeGateway lab1(url, "lab1");
  const auto ids = deploy(1, {"lab1"});
  lab1.behave(FakeGateway::fail("the device is gone"));
  const auto result = update(ids);
  EXPECT_THAT(result.outcomes[0].reason,
              AllOf(HasSubstr("the device is gone"), HasSubstr("going back to turtle.so"), HasSubstr("failed")));
  EXPECT_EQ(order(lab1, ids[0]).sha256, v1) << "its order names the version before all the same";
}

TEST_F(Update, NothingChangesWhenOneInstanceCannotBeUpdated) {
  FakeGateway lab1(url, "lab1");
  auto lab2 = std::make_unique<FakeGateway>(url, "lab2");
  const auto ids = deploy(1, {"lab1", "lab2"});
  lab2.reset();
  ASSERT_TRUE(test::eventually([&] {
    const auto gateways = master->gateways();
    return std::any_of(gateways.begin(), gateways.end(), [](const auto& one) { return !one.alive; });
  }));
  const auto result = update(ids);
  EXPECT_THAT(result.outcomes[0].reason, AllOf(HasSubstr("nothing was changed"), HasSubstr("lab2")));
  EXPECT_THAT(result.outcomes[1].reason, HasSubstr("is lost"));
  EXPECT_EQ(order(lab1, ids[0]).sha256, v1);
}

TEST_F(Update, AnInactiveInstanceStaysInactive) {
  FakeGateway lab1(url, "lab1");
  const auto ids = deploy(1, {"lab1"});
  ASSERT_TRUE(master->stop({ids, {}, {}}).all_done());
  const auto result = update(ids);
  EXPECT_TRUE(result.all_done()) << result.summary();
  EXPECT_FALSE(order(lab1, ids[0]).active);
  EXPECT_EQ(master->drivers().at(0).state, DriverState::inactive);
}

TEST_F(Update, TheSameUpdateAgainChangesNothingAndOneThatStoppedHalfWayGoesOn) {
  FakeGateway lab1(url, "lab1"), lab2(url, "lab2");
  const auto ids = deploy(1, {"lab1", "lab2"});
  ASSERT_TRUE(update({ids[0]}).all_done());
  ASSERT_TRUE(test::eventually([&] {
    const auto order = lab1.orders().at(0);
    return order.sha256 == v2 && !order.previous;
  }));
  const auto seen = lab1.orders_seen();
  const auto result = update(ids);
  EXPECT_TRUE(result.all_done()) << result.summary();
  EXPECT_THAT(result.outcomes[0].reason, HasSubstr("already"));
  EXPECT_EQ(lab1.orders_seen(), seen);
  EXPECT_EQ(order(lab2, ids[1]).sha256, v2);
}

TEST_F(Update, AFailedInstanceIsMendedByAnUpdate) {
  FakeGateway lab1(url, "lab1", [](const OrderRecord& order) {
    return order.sha256 == v1 ? FakeGateway::Report{DriverState::failed, "its plugin is broken"}
                              : *FakeGateway::obey(order);
  });
  DeployRequest request;
  request.plugin = "turtle.so";
  request.sha256 = v1;
  const auto broken = master->deploy(request).outcomes.at(0);
  ASSERT_EQ(broken.outcome, OrderOutcome::failed);
  const auto result = update({broken.instance});
  EXPECT_TRUE(result.all_done()) << result.summary();
}

TEST_F(Update, AMasterThatEndsInTheMiddleLeavesOrdersThatSayWhatRuns) {
  FakeGateway lab1(url, "lab1"), lab2(url, "lab2");
  const auto ids = deploy(1, {"lab1", "lab2"});
  lab1.behave(FakeGateway::say_nothing());
  auto running = std::async(std::launch::async, [&] { return update(ids); });
  ASSERT_TRUE(test::eventually([&] { return order(lab1, ids[0]).sha256 == v2; }));
  master->close();
  const auto result = running.get();
  EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::unknown);
  EXPECT_EQ(result.outcomes[1].outcome, OrderOutcome::failed);
  EXPECT_EQ(order(lab1, ids[0]).version(), (discovery::PluginVersion{"turtle-2.so", v2}));
  EXPECT_EQ(order(lab1, ids[0]).previous, (discovery::PluginVersion{"turtle.so", v1}));
  EXPECT_EQ(order(lab2, ids[1]).version(), (discovery::PluginVersion{"turtle.so", v1}));
}

TEST_F(Update, OneUpdateOfAnInstanceAtATime) {
  FakeGateway lab1(url, "lab1");
  const auto ids = deploy(1, {"lab1"});
  lab1.behave(FakeGateway::say_nothing());
  auto running = std::async(std::launch::async, [&] { return update(ids); });
  ASSERT_TRUE(test::eventually([&] { return lab1.orders().at(0).sha256 == v2; }));
  const auto second = update(ids);
  EXPECT_EQ(second.refusal, OrderRefusal::bad_request);
  EXPECT_THAT(second.text, HasSubstr("under way already"));
  lab1.report(ids[0], DriverState::active);
  EXPECT_TRUE(running.get().all_done());
}

TEST_F(Update, WhatCannotBeIsRefused) {
  FakeGateway lab1(url, "lab1");
  const auto ids = deploy(1, {"lab1"});
  EXPECT_EQ(update({"nobody"_instance}).refusal, OrderRefusal::unknown_instance);
  EXPECT_EQ(update({}).refusal, OrderRefusal::bad_request);
  EXPECT_EQ(update(ids, -1).refusal, OrderRefusal::bad_request);
  EXPECT_THAT(update(ids, 0, {}, "../../etc/passwd").text, HasSubstr("64 hexadecimal digits"));
}

}  // namespace
}  // namespace iotcloud::master
