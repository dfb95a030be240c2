#include <future>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/master/orders/order_book.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::DriverState;
using std::chrono::milliseconds;
using test::FakeGateway;
using test::TestMaster;
using testing::AllOf;
using testing::HasSubstr;
using testing::SizeIs;

// Arguments that are swapped do not compile.
template <typename... Arguments>
concept AnOrderInTheBook = requires(OrderBook& book, const Arguments&... arguments) {
  book.get(arguments...);
};
static_assert(AnOrderInTheBook<discovery::GatewayId, discovery::InstanceId>);
static_assert(!AnOrderInTheBook<discovery::InstanceId, discovery::GatewayId>);
static_assert(!AnOrderInTheBook<std::string, std::string>);

DeployRequest turtle(std::vector<std::string> gateways = {}) {
  DeployRequest request;
  request.plugin = "turtle.so";
  request.gateways = {gateways.begin(), gateways.end()};
  return request;
}

InstanceSelection only(const std::string& instance) {
  return {{discovery::InstanceId(instance)}, {}, {}};
}

class MasterOrders : public testing::Test {
 protected:
  MasterOrders() { EXPECT_TRUE(master.leads()); }

  const std::string url = test::fresh_registry_url();
  const discovery::Paths paths;
  TestMaster master{url};
};

TEST_F(MasterOrders, DeployIsDoneWhenTheGatewayReportsTheInstanceActive) {
  FakeGateway gateway(url, "lab1");
  auto request = turtle({"lab1"});
  request.properties = {{"source", "simulation"}};
  request.metadata = {{"room", "12"}};

  const auto result = master->deploy(request);

  ASSERT_TRUE(result.all_done()) << result.summary();
  ASSERT_THAT(result.outcomes, SizeIs(1));
  EXPECT_EQ(result.outcomes[0].gateway, "lab1");
  const auto drivers = master->drivers();
  ASSERT_THAT(drivers, SizeIs(1));
  EXPECT_EQ(drivers[0].instance, result.outcomes[0].instance);
  EXPECT_EQ(drivers[0].state, DriverState::active);
  EXPECT_EQ(drivers[0].metadata.at("room"), "12");
  ASSERT_THAT(gateway.orders(), SizeIs(1));
  EXPECT_EQ(gateway.orders()[0].properties.at("source"), "simulation");
}

TEST_F(MasterOrders, DeployFailsWithTheGatewaysReason) {
  FakeGateway gateway(url, "lab1", FakeGateway::fail("turtle.so: no such file in /plugins"));
  const auto result = master->deploy(turtle({"lab1"}));
  EXPECT_FALSE(result.all_done());
  ASSERT_THAT(result.outcomes, SizeIs(1));
  EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::failed);
  EXPECT_EQ(result.outcomes[0].reason, "turtle.so: no such file in /plugins");
  EXPECT_THAT(result.summary(), HasSubstr("no such file"));
}

TEST_F(MasterOrders, ASilentGatewayMakesTheOutcomeUnknownAndTheOrderStands) {
  FakeGateway gateway(url, "lab1", FakeGateway::say_nothing());
  std::size_t orders = 0;
  for (const char* driver : {"", "turtle"}) {  // whose record may be anywhere, and at a known place
    auto request = turtle({"lab1"});
    request.driver = discovery::DriverName(driver);
    request.wait = milliseconds(50);
    const auto result = master->deploy(request);
    ASSERT_THAT(result.outcomes, SizeIs(1));
    EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::unknown);
    EXPECT_THAT(result.outcomes[0].reason, HasSubstr("may still happen"));
    EXPECT_TRUE(gateway.wait_for_orders(++orders));
  }
}

TEST_F(MasterOrders, ThereIsNoSuccessBeforeTheStateIsActive) {
  FakeGateway gateway(url, "lab1", [](const auto&) {
    return FakeGateway::Report{DriverState::starting, "connecting"};
  });
  auto answer = std::async(std::launch::async, [&] { return master->deploy(turtle({"lab1"})); });
  ASSERT_TRUE(test::eventually([&] { return master->drivers().size() == 1; }));
  EXPECT_EQ(answer.wait_for(milliseconds(50)), std::future_status::timeout);
  gateway.report(gateway.orders().at(0).instance, DriverState::active);
  EXPECT_TRUE(answer.get().all_done());
}

TEST_F(MasterOrders, OneSlowGatewayDelaysNoOther) {
  FakeGateway slow(url, "a-slow", FakeGateway::say_nothing());
  FakeGateway quick(url, "b-quick");
  auto result = std::async(std::launch::async, [&] { return master->deploy(turtle()); });
  // The quick one is done while nothing was heard of the slow one, which comes first in the list.
  ASSERT_TRUE(test::eventually([&] { return master->drivers().size() == 1; }));
  ASSERT_TRUE(slow.wait_for_orders(1));
  slow.report(slow.orders()[0].instance, DriverState::active);
  EXPECT_TRUE(result.get().all_done());
}

TEST_F(MasterOrders, EachGatewayHasItsOwnOutcome) {
  FakeGateway good(url, "lab1");
  FakeGateway bad(url, "lab2", FakeGateway::fail("broker refused"));
  FakeGateway silent(url, "lab3", FakeGateway::say_nothing());
  milliseconds limit(500);
  const auto result = test::with_time_for_all_but(1, limit, [&](milliseconds wait) {
    auto request = turtle();
    request.wait = wait;
    return master->deploy(request);
  });
  ASSERT_THAT(result.outcomes, SizeIs(3));
  EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::done);
  EXPECT_EQ(result.outcomes[1].outcome, OrderOutcome::failed);
  EXPECT_EQ(result.outcomes[2].outcome, OrderOutcome::unknown);
  EXPECT_FALSE(result.all_done());
}

TEST_F(MasterOrders, CountMakesThatManyInstancesOnEachGateway) {
  FakeGateway gateway(url, "lab1");
  auto request = turtle({"lab1"});
  request.count = 20;
  const auto result = master->deploy(request);
  EXPECT_TRUE(result.all_done()) << result.summary();
  std::set<std::string> ids;
  for (const auto& outcome : result.outcomes) ids.insert(outcome.instance);
  EXPECT_THAT(ids, SizeIs(20));
  EXPECT_THAT(gateway.orders(), SizeIs(20));
}

TEST_F(MasterOrders, AGatewayNamedTwiceGetsOneOrder) {
  FakeGateway gateway(url, "lab1");
  EXPECT_THAT(master->deploy(turtle({"lab1", "lab1"})).outcomes, SizeIs(1));
}

TEST_F(MasterOrders, AnOrderForALostGatewayIsPendingAndIsFollowedWhenItComesBack) {
  { FakeGateway gone(url, "lab1"); }
  ASSERT_TRUE(test::eventually([&] { return !master->gateways().at(0).alive; }));
  const auto result = master->deploy(turtle({"lab1"}));
  ASSERT_THAT(result.outcomes, SizeIs(1));
  EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::pending);
  EXPECT_THAT(result.outcomes[0].reason, HasSubstr("gateway is lost"));
  EXPECT_FALSE(result.all_done());

  FakeGateway back(url, "lab1");
  EXPECT_TRUE(test::eventually([&] { return master->drivers().size() == 1; }));
}

TEST_F(MasterOrders, AMasterToldSoRecordsNothingForALostGateway) {
  master.end();
  auto options = TestMaster::quick();
  options.record_for_lost_gateways = false;
  TestMaster strict(url, options);
  ASSERT_TRUE(strict.leads());
  { FakeGateway gone(url, "lab1"); }
  ASSERT_TRUE(test::eventually([&] { return !strict->gateways().at(0).alive; }));
  const auto result = strict->deploy(turtle({"lab1"}));
  EXPECT_EQ(result.outcomes.at(0).outcome, OrderOutcome::failed);
  EXPECT_FALSE(strict.registry().get(paths.order("lab1"_gateway, result.outcomes[0].instance)));
}

TEST_F(MasterOrders, AnUnknownGatewayIsRefusedWithTheKnownOnesAndNothingIsOrdered) {
  FakeGateway one(url, "lab1");
  FakeGateway two(url, "lab2");
  const auto result = master->deploy(turtle({"lab1", "lab3"}));
  EXPECT_EQ(result.refusal, OrderRefusal::unknown_gateway);
  EXPECT_THAT(result.text, AllOf(HasSubstr("lab3"), HasSubstr("lab1, lab2")));
  EXPECT_THAT(result.outcomes, SizeIs(0));
  EXPECT_EQ(one.orders_seen(), 0);
}

TEST_F(MasterOrders, WithoutAnyGatewayTheRefusalSaysHowToGetOne) {
  const auto result = master->deploy(turtle());
  EXPECT_EQ(result.refusal, OrderRefusal::unknown_gateway);
  EXPECT_THAT(result.text, HasSubstr("iotcloud-gateway"));
}

TEST_F(MasterOrders, RequestsThatCannotBeAreRefused) {
  FakeGateway gateway(url, "lab1");
  for (const std::string plugin : {"", "../turtle.so", "a/b.so", ".."}) {
    auto request = turtle({"lab1"});
    request.plugin = plugin;
    EXPECT_EQ(master->deploy(request).refusal, OrderRefusal::bad_request) << plugin;
  }
  auto request = turtle({"lab1"});
  request.driver = "a/b"_driver;
  EXPECT_EQ(master->deploy(request).refusal, OrderRefusal::bad_request);
  request = turtle({"lab1"});
  request.count = 0;
  EXPECT_EQ(master->deploy(request).refusal, OrderRefusal::bad_request);
  request = turtle({"lab1"});
  request.properties["map"] = std::string(600'000, 'x');
  EXPECT_THAT(master->deploy(request).text, HasSubstr("600"));
  EXPECT_EQ(master->stop({}).refusal, OrderRefusal::bad_request);
  EXPECT_EQ(gateway.orders_seen(), 0);
}

TEST_F(MasterOrders, StopAndStartAreDoneWhenTheStateIsReached) {
  FakeGateway gateway(url, "lab1");
  const auto id = master->deploy(turtle({"lab1"})).outcomes.at(0).instance;
  EXPECT_TRUE(master->stop(only(id)).all_done());
  EXPECT_EQ(master->drivers().at(0).state, DriverState::inactive);
  EXPECT_FALSE(gateway.orders().at(0).active);
  EXPECT_TRUE(master->start(only(id)).all_done());
  EXPECT_EQ(master->drivers().at(0).state, DriverState::active);
}

TEST_F(MasterOrders, UndeployIsDoneWhenTheRecordIsGone) {
  FakeGateway gateway(url, "lab1");
  const auto id = master->deploy(turtle({"lab1"})).outcomes.at(0).instance;
  EXPECT_TRUE(master->undeploy(only(id)).all_done());
  EXPECT_THAT(master->drivers(), SizeIs(0));
  EXPECT_TRUE(gateway.wait_for_orders(0));
}

TEST_F(MasterOrders, UndeployIsUnknownWhileTheRecordStays) {
  FakeGateway gateway(url, "lab1");
  const auto id = master->deploy(turtle({"lab1"})).outcomes.at(0).instance;
  gateway.behave(FakeGateway::say_nothing());
  auto selection = only(id);
  selection.wait = milliseconds(50);
  EXPECT_EQ(master->undeploy(selection).outcomes.at(0).outcome, OrderOutcome::unknown);
}

TEST_F(MasterOrders, AnUnknownInstanceIsRefusedAndNoneIsChanged) {
  FakeGateway gateway(url, "lab1");
  const auto id = master->deploy(turtle({"lab1"})).outcomes.at(0).instance;
  const auto result = master->undeploy({{id, "nosuch"_instance}, {}, {}});
  EXPECT_EQ(result.refusal, OrderRefusal::unknown_instance);
  EXPECT_THAT(result.text, HasSubstr("nosuch"));
  EXPECT_THAT(master->drivers(), SizeIs(1));
}

TEST_F(MasterOrders, AnInstanceOnAnotherGatewayThanTheNamedOnesIsRefused) {
  FakeGateway one(url, "lab1");
  FakeGateway two(url, "lab2");
  const auto id = master->deploy(turtle({"lab1"})).outcomes.at(0).instance;
  const auto result = master->stop({{id}, {"lab2"_gateway}, {}});
  EXPECT_EQ(result.refusal, OrderRefusal::unknown_instance);
  EXPECT_THAT(result.text, HasSubstr("on gateway lab1, not on lab2"));
  EXPECT_TRUE(master->stop({{id}, {"lab1"_gateway}, {}}).all_done());
}

TEST_F(MasterOrders, AnOldFailureIsNotTheAnswerToANewOrder) {
  FakeGateway gateway(url, "lab1", FakeGateway::fail("device not there"));
  const auto id = master->deploy(turtle({"lab1"})).outcomes.at(0).instance;
  gateway.behave(FakeGateway::say_nothing());
  auto started = std::async(std::launch::async, [&] { return master->start(only(id)); });
  ASSERT_TRUE(test::eventually([&] { return gateway.orders_seen() == 2; }));
  gateway.report(id, DriverState::active);
  EXPECT_TRUE(started.get().all_done());
}

TEST_F(MasterOrders, UndeployClearsWhatAGatewayThatIsNotRegisteredAnyMoreLeft) {
  std::string id;
  {
    FakeGateway gone(url, "lab1");
    id = master->deploy(turtle({"lab1"})).outcomes.at(0).instance;
  }
  discovery::remove_tree(master.registry(), paths.gateway("lab1"_gateway));
  ASSERT_TRUE(test::eventually([&] { return master->gateways().empty(); }));
  EXPECT_EQ(master->stop(only(id)).outcomes.at(0).outcome, OrderOutcome::failed);
  EXPECT_TRUE(master->undeploy(only(id)).all_done());
  EXPECT_THAT(master->drivers(), SizeIs(0));
}

TEST_F(MasterOrders, ClosingAnswersOrdersUnderWayAsUnknown) {
  FakeGateway silent(url, "lab1", FakeGateway::say_nothing());
  auto result = std::async(std::launch::async, [&] { return master->deploy(turtle({"lab1"})); });
  ASSERT_TRUE(silent.wait_for_orders(1));
  master->close();
  EXPECT_EQ(result.get().outcomes.at(0).outcome, OrderOutcome::unknown);
}

TEST_F(MasterOrders, ARecordThatCannotBeReadIsNoAnswer) {
  FakeGateway silent(url, "lab1", FakeGateway::say_nothing());
  auto request = turtle({"lab1"});
  request.driver = "turtle"_driver;
  request.wait = test::patience;
  auto result = std::async(std::launch::async, [&] { return master->deploy(request); });
  ASSERT_TRUE(silent.wait_for_orders(1));
  const auto id = silent.orders()[0].instance;
  discovery::put(master.registry(), paths.instance("turtle"_driver, id), "no record");
  silent.report(id, DriverState::active);
  EXPECT_TRUE(result.get().all_done());
}

}  // namespace
}  // namespace iotcloud::master
