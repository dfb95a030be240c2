// What the thief of one gateway writes into the registry, beside a master: records that say that they are of others.
// Masters may write everywhere, so what they do because of such a record, they do with more rights than the thief has.
#include <optional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::DriverState;
using discovery::InstanceId;
using test::FakeGateway;
using test::TestMaster;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

/// The gateway "stolen" is the thief's. On "lab2" an instance of the driver turtle runs, the victim.
class ForgedRecords : public testing::Test {
 protected:
  ForgedRecords() {
    EXPECT_TRUE(master.leads());
    DeployRequest request;
    request.plugin = "turtle.so";
    request.gateways = {"lab2"_gateway};
    const auto deployed = master->deploy(request);
    EXPECT_TRUE(deployed.all_done()) << deployed.summary();
    victim = InstanceId(deployed.outcomes.at(0).instance);
  }
  discovery::DriverRecord forged(const std::string& gateway, const std::string& driver = "turtle") const {
    discovery::DriverRecord record;
    record.name = discovery::DriverName(driver);
    record.instance = victim;
    record.gateway = discovery::GatewayId(gateway);
    record.state = DriverState::active;
    return record;
  }
  /// Puts it below a driver whose name comes before all others.
  void put_first(const std::string& bytes) const {
    discovery::put(*thief, paths.instance("aaa"_driver, victim), bytes);
  }
  /// Makes a gateway of a name that nobody has and that comes before all others.
  void seize_gateway() const {
    discovery::GatewayRecord record;
    record.id = "stolen"_gateway;
    record.host = "127.0.0.1";
    record.port = 9;
    discovery::put(*thief, paths.gateway("aaa"_gateway), encode(record));
  }
  InstanceSelection only() const { return {{victim}, {}, {}}; }
  bool victim_is(bool active) const {
    const auto orders = lab2.orders();
    return orders.size() == 1 && orders[0].active == active;
  }
  /// The victim's gateway follows each of these orders.
  void expect_orders_to_reach_the_victim() {
    const auto stopped = master->stop(only());
    EXPECT_TRUE(stopped.all_done()) << stopped.summary();
    EXPECT_TRUE(victim_is(false));
    const auto started = master->start(only());
    EXPECT_TRUE(started.all_done()) << started.summary();
    EXPECT_TRUE(victim_is(true));
    UpdateRequest update;
    update.selection = only();
    update.plugin = "turtle-2.so";
    update.settle = std::chrono::milliseconds(0);
    const auto updated = master->update(update);
    EXPECT_TRUE(updated.all_done()) << updated.summary();
    EXPECT_EQ(lab2.orders().at(0).plugin, "turtle-2.so");
    const auto gone = master->undeploy(only());
    EXPECT_TRUE(gone.all_done()) << gone.summary();
    EXPECT_THAT(lab2.orders(), IsEmpty());
    EXPECT_EQ(stolen.orders_seen(), 0);
  }

  const std::string url = test::fresh_registry_url();
  const discovery::Paths paths;
  const std::unique_ptr<discovery::Registry> thief = test::open_registry(url);
  FakeGateway lab2{url, "lab2"};
  FakeGateway stolen{url, "stolen"};
  TestMaster master{url};
  InstanceId victim;
};

TEST_F(ForgedRecords, OfAnotherGatewaysInstanceKeepNoOrderFromIt) {
  put_first(encode(forged("stolen", "aaa")));
  expect_orders_to_reach_the_victim();
}

TEST_F(ForgedRecords, ThatSayTheVictimsGatewayKeepNoOrderFromItEither) {
  put_first(encode(forged("lab2", "aaa")));
  expect_orders_to_reach_the_victim();
}

TEST_F(ForgedRecords, ThatCannotBeReadKeepNoOrderFromTheInstanceWhoseIdTheyHave) {
  put_first("\x0bgarbage");
  expect_orders_to_reach_the_victim();
}

TEST_F(ForgedRecords, AndOrdersOfAGatewayWithASeizedNameKeepNoOrderFromTheInstanceWhoseIdTheyHave) {
  seize_gateway();
  discovery::OrderRecord order;
  order.instance = victim;
  order.plugin = "turtle.so";
  discovery::put(*thief, paths.order("aaa"_gateway, victim), encode(order));
  put_first(encode(forged("aaa", "aaa")));
  expect_orders_to_reach_the_victim();
  EXPECT_TRUE(thief->get(paths.order("aaa"_gateway, victim))) << "of those nobody took any";
}

TEST_F(ForgedRecords, OfAnotherGatewaysInstanceDoNotKeepItFromDraining) {
  put_first(encode(forged("stolen", "aaa")));
  const auto drained = master->give("drain", R"({"gateways":["lab2"]})").result;
  EXPECT_TRUE(drained.all_done()) << drained.summary();
  EXPECT_TRUE(victim_is(false));
}

TEST_F(ForgedRecords, HaveAMasterThatForgetsTheirGatewayRemoveNothingOfOthers) {
  const auto its_record = paths.instance("turtle"_driver, victim);
  ASSERT_TRUE(thief->get(its_record));
  discovery::put(*thief, paths.instance("turtle"_driver, "mine"_instance), encode(forged("stolen")));
  std::optional<FakeGateway> lost(std::in_place, url, "lost");
  discovery::put(*thief, paths.instance("turtle"_driver, "other"_instance), encode(forged("lost")));
  lost.reset();
  ASSERT_TRUE(test::eventually([&] { return !thief->get(paths.gateway_alive("lost"_gateway)); }));
  const auto forgotten = master->give("forgetGateway", R"({"gateways":["lost"]})").result;
  EXPECT_TRUE(forgotten.all_done()) << forgotten.summary();
  EXPECT_TRUE(thief->get(its_record));
  EXPECT_TRUE(thief->get(its_record + "/kinect"));
  EXPECT_FALSE(thief->get(paths.instance("turtle"_driver, "other"_instance))) << "that is what was of that gateway";
  EXPECT_TRUE(thief->get(paths.instance("turtle"_driver, "mine"_instance)));
}

TEST_F(ForgedRecords, OfAGatewayAreThoseOfTheirOwnName) {
  seize_gateway();
  std::vector<std::string> ids;
  for (const auto& gateway : master->gateways()) ids.push_back(gateway.record.id.str());
  EXPECT_THAT(ids, ElementsAre("aaa", "lab2", "stolen"));

  DeployRequest request;
  request.plugin = "meter.so";
  request.wait = std::chrono::milliseconds(0);
  const auto deployed = master->deploy(request);
  std::vector<std::string> targets;
  for (const auto& outcome : deployed.outcomes) targets.push_back(outcome.gateway.str());
  EXPECT_THAT(targets, ElementsAre("aaa", "lab2", "stolen")) << "none gets it twice";
  EXPECT_TRUE(stolen.wait_for_orders(1));
}

}  // namespace
}  // namespace iotcloud::master
