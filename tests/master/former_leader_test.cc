// Orders of a master that stood still between its decision and its write, while another one took the lead.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>
#include <iotcloud/tests/master/held_up_registry.h>

namespace iotcloud::master {
namespace {

using test::FakeGateway;
using test::TestMaster;
using testing::HasSubstr;
using testing::IsEmpty;

MasterOptions at(const std::string& address) {
  auto options = TestMaster::quick();
  options.address = address;
  return options;
}

DeployRequest one_turtle() {
  DeployRequest request;
  request.plugin = "turtle.so";
  request.name = "turtle";
  return request;
}

class FormerLeader : public testing::Test {
 protected:
  FormerLeader() {
    EXPECT_TRUE(test::eventually([&] { return both_stand(); }));
  }

  /// Whether both masters have their nodes in the election.
  bool both_stand() {
    const auto members = second_registry->children(paths.masters());
    return members && members->size() == 2;
  }

  /// The first master's next write is held up until the second one leads and has done `then`.
  void hold_up(std::function<void()> then = [] {}) {
    registry.before_next_write([this, then = std::move(then)] {
      server->expire(first_session);
      ASSERT_TRUE(test::eventually([&] { return second.status().leading; }));
      then();
      // It is back under another session, and stands behind the second one.
      ASSERT_TRUE(test::eventually([&] { return both_stand(); }));
    });
  }
  std::optional<discovery::Node> order_node(const discovery::InstanceId& id) {
    return second_registry->get(paths.order("lab1"_gateway, id));
  }
  static void expect_lost_lead(const OrderResult& result) {
    ASSERT_EQ(result.outcomes.size(), 1U) << result.summary();
    EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::failed);
    EXPECT_THAT(result.outcomes[0].reason, HasSubstr("lost its lead"));
  }

  const std::string url = test::fresh_registry_url();
  const discovery::Paths paths;
  test::HeldUpRegistry registry{test::open_registry(url)};
  const std::shared_ptr<discovery::embedded::RegistryServer> server =
      discovery::embedded::RegistryServer::named(url.substr(std::string("embedded://").size()));
  Master first{registry, at("127.0.0.1:1111")};
  const std::int64_t first_session = [&] {
    EXPECT_TRUE(test::eventually([&] { return first.status().leading; }));  // before another one comes
    return server->sessions().front();
  }();
  const std::unique_ptr<discovery::Registry> second_registry = test::open_registry(url);
  Master second{*second_registry, at("127.0.0.1:2222")};
  FakeGateway gateway{url, "lab1"};
};

/// The new order has the id and the version of the one that the former leader read.
TEST_F(FormerLeader, DoesNotOverwriteTheNewLeadersOrder) {
  const auto id = first.deploy(one_turtle()).outcomes.at(0).instance;
  hold_up([&] {
    EXPECT_TRUE(second.undeploy({{id}, {}, {}}).all_done());
    EXPECT_TRUE(second.deploy(one_turtle()).all_done());
  });
  expect_lost_lead(first.stop({{id}, {}, {}}));
  const auto node = order_node(id);
  ASSERT_TRUE(node);
  const auto order = discovery::decode_order(node->data, id);
  EXPECT_EQ(order.epoch, second.status().epoch);
  EXPECT_TRUE(order.active);
}

TEST_F(FormerLeader, DoesNotChangeAnOrderThatTheNewLeaderHasNotTouched) {
  const auto id = first.deploy(one_turtle()).outcomes.at(0).instance;
  hold_up();
  expect_lost_lead(first.update_metadata({{id}, {}, {}}, {{"site", "lab"}}));
  EXPECT_EQ(order_node(id)->version, 0);
}

TEST_F(FormerLeader, DoesNotRemoveAnOrder) {
  const auto id = first.deploy(one_turtle()).outcomes.at(0).instance;
  hold_up();
  expect_lost_lead(first.undeploy({{id}, {}, {}}));
  EXPECT_TRUE(order_node(id));
}

TEST_F(FormerLeader, DeploysNothing) {
  hold_up();
  expect_lost_lead(first.deploy(one_turtle()));
  EXPECT_THAT(second.orders(), IsEmpty());
  EXPECT_EQ(gateway.orders_seen(), 0);
}

TEST_F(FormerLeader, DrainsNothing) {
  hold_up();
  const auto result = first.drain({{"lab1"_gateway}, {}});
  EXPECT_EQ(result.refusal, OrderRefusal::not_leading);
  EXPECT_EQ(result.leader, "127.0.0.1:2222");
  EXPECT_FALSE(second.gateways().at(0).draining);
}

TEST_F(FormerLeader, OrdersNoTopology) {
  discovery::TopologyRecord topology;
  topology.name = "t"_topology;
  discovery::put(*second_registry, paths.topology("t"_topology), encode(topology));
  hold_up();
  TopologyRequest request;
  request.topology = "t"_topology;
  request.change = TopologyChange::deactivate;
  const auto result = first.order(request);
  EXPECT_EQ(result.refusal, OrderRefusal::not_leading);
  EXPECT_EQ(result.leader, "127.0.0.1:2222");
  EXPECT_FALSE(second.topologies().at(0).order);
}

}  // namespace
}  // namespace iotcloud::master
