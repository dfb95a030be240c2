#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using test::FakeGateway;
using test::TestMaster;
using testing::HasSubstr;
using testing::SizeIs;

MasterOptions named(const std::string& id, const std::string& address) {
  auto options = TestMaster::quick();
  options.id = id;
  options.address = address;
  return options;
}

DeployRequest turtle_anywhere() {
  DeployRequest request;
  request.plugin = "turtle.so";
  return request;
}

class Masters : public testing::Test {
 protected:
  const std::string url = test::fresh_registry_url();
  const discovery::Paths paths;
  TestMaster first{url, named("m1", "127.0.0.1:1111")};
};

TEST_F(Masters, OneLeadsAndTheOtherAnswersReadsAndRefusesOrdersNamingTheLeader) {
  ASSERT_TRUE(first.leads());
  FakeGateway gateway(url, "lab1");
  TestMaster second(url, named("m2", "127.0.0.1:2222"));
  ASSERT_TRUE(test::eventually([&] { return second->status().leader == "127.0.0.1:1111"; }));
  EXPECT_FALSE(second->status().leading);

  const auto refused = second->deploy(turtle_anywhere());
  EXPECT_EQ(refused.refusal, OrderRefusal::not_leading);
  EXPECT_EQ(refused.leader, "127.0.0.1:1111");
  EXPECT_THAT(refused.text, HasSubstr("127.0.0.1:1111"));
  EXPECT_EQ(gateway.orders_seen(), 0);

  EXPECT_TRUE(first->deploy(turtle_anywhere()).all_done());
  EXPECT_THAT(second->drivers(), SizeIs(1));
  EXPECT_THAT(second->gateways(), SizeIs(1));
}

TEST_F(Masters, ASuccessorPicksUpWhatStandsWithAGreaterEpoch) {
  ASSERT_TRUE(first.leads());
  FakeGateway gateway(url, "lab1");
  TestMaster second(url, named("m2", "127.0.0.1:2222"));
  const auto id = first->deploy(turtle_anywhere()).outcomes.at(0).instance;
  const auto first_epoch = gateway.orders().at(0).epoch;
  EXPECT_EQ(first_epoch, first->status().epoch);
  EXPECT_GT(first_epoch, 0);

  first.end();
  ASSERT_TRUE(second.leads());
  EXPECT_TRUE(second->stop({{id}, {}, {}}).all_done());
  EXPECT_GT(gateway.orders().at(0).epoch, first_epoch);
}

TEST_F(Masters, AnOrderOfALaterLeaderIsNotChangedByAnEarlierOne) {
  ASSERT_TRUE(first.leads());
  FakeGateway gateway(url, "lab1");
  const auto id = first->deploy(turtle_anywhere()).outcomes.at(0).instance;
  auto order = gateway.orders().at(0);
  order.epoch += 1000;
  discovery::put(first.registry(), paths.order("lab1"_gateway, id), encode(order));

  for (const auto& result : {first->stop({{id}, {}, {}}), first->undeploy({{id}, {}, {}})}) {
    EXPECT_EQ(result.outcomes.at(0).outcome, OrderOutcome::failed);
    EXPECT_THAT(result.outcomes.at(0).reason, HasSubstr("later master"));
  }
  EXPECT_TRUE(first.registry().get(paths.order("lab1"_gateway, id)));
}

}  // namespace
}  // namespace iotcloud::master
