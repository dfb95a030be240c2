// What ZooKeeper has from its beginning, `/` and `/zookeeper`, belongs to everybody who reaches it: a driver host, too,
// which needs no credential for that, only the port of the tunnel on its machine.
#include <algorithm>
#include <chrono>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/tests/discovery/fleet_users.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/servers/private_server.h>

namespace iotcloud::discovery::tests {
namespace {

using iotcloud::tests::eventually;
using iotcloud::tests::patience;
using testing::ElementsAre;
using testing::IsEmpty;

constexpr int over_quota = -125;  // which the C client has no name for

/// A server of its own, which obeys quotas, and a fleet whose master has made the branches.
class ServersOwnNodes : public testing::Test {
 protected:
  std::unique_ptr<Registry> member(const std::string& user) const { return make_registry(options_of(user)); }
  RegistryOptions options_of(const std::string& user) const {
    RegistryOptions options;
    options.url = server_.url();
    options.operation_timeout = patience;
    options.user = user;
    options.password = fleet_password(user);
    options.access = access_;
    return options;
  }
  std::unique_ptr<Registry> started_master() const {
    auto registry = member("masters");
    const auto kept = keep_branches(*registry, paths_);
    const bool made = eventually([&] {
      const auto nodes = registry->get_all(paths_.branches());
      return std::all_of(nodes.begin(), nodes.end(), [](const auto& node) { return node.has_value(); });
    });
    if (!made) throw std::runtime_error("the branches are not made");
    return registry;
  }
  RenewedRights close() const { return renew_rights(options_of("masters"), paths_, {}, ServersNodes::closed); }
  /// Limits the nodes at and below a path, as ZooKeeper's `setquota -N` does. \return the first refusal
  static int set_quota(BareClient& client, const std::string& path, int nodes) {
    const std::string limit = std::to_string(nodes);
    for (const auto& [name, data] :
         {std::pair<std::string, std::string>("", ""),
          {"/zookeeper_limits", "count=" + limit + ",bytes=-1=;byteHardLimit=-1;countHardLimit=" + limit},
          {"/zookeeper_stats", "count=0,bytes=0"}}) {
      if (const int code = client.create("/zookeeper/quota" + path + name, data); code != ZOK) return code;
    }
    return ZOK;
  }
  static void remove_quota(BareClient& client, const std::string& path) {
    for (const std::string name : {"/zookeeper_limits", "/zookeeper_stats", ""})
      EXPECT_EQ(client.remove("/zookeeper/quota" + path + name), ZOK) << name;
  }

  iotcloud::tests::PrivateServer server_{"zookeeper.py", {"--setting", "enforceQuota=true"}};
  const Paths paths_;
  const std::shared_ptr<const RegistryAccess> access_ = std::make_shared<const RegistryAccess>(fleet_users(), paths_);
};

TEST_F(ServersOwnNodes, AreChangedByADriverHostWithoutACredentialUntilTheyAreClosed) {
  const auto master = started_master();
  const auto gateway = member("g1");
  put(*gateway, paths_.gateway("g1"_gateway), "record");
  BareClient host(server_.url(), "");
  BareClient fellow(server_.url(), "masters");
  ASSERT_EQ(host.create("/kafka"), ZOK) << "a chroot, as others make it";
  // The attack.
  EXPECT_EQ(host.create("/without-end-1"), ZOK);
  ASSERT_EQ(set_quota(host, "/iot", 1), ZOK);
  EXPECT_EQ(fellow.create("/iot/more"), over_quota) << "masters can write nothing new";
  const auto looked = renew_rights(options_of("masters"), paths_);
  EXPECT_THAT(looked.open, ElementsAre("/", "/zookeeper", "/zookeeper/quota", "/zookeeper/quota/iot",
                                       testing::StartsWith("/zookeeper/quota/iot/zookeeper_"),
                                       testing::StartsWith("/zookeeper/quota/iot/zookeeper_")));

  const auto done = close();
  EXPECT_THAT(done.open, IsEmpty());
  EXPECT_THAT(done.seized, IsEmpty());
  EXPECT_EQ(close().changed, 0u) << "each node has its rights already";
  remove_quota(fellow, "/iot");
  ASSERT_EQ(set_quota(fellow, "/iot", 1000), ZOK) << "masters set quotas";

  server_.kill();
  server_.start();
  BareClient again(server_.url(), "");
  BareClient thief(server_.url(), "g2");
  BareClient worker(server_.url(), "workers");
  for (BareClient* stranger : {&again, &thief, &worker}) {
    for (const std::string path :
         {"/without-end-2", "/zookeeper/more", "/zookeeper/quota/kafka", "/zookeeper/quota/iot/gateways", "/iot/more"})
      EXPECT_EQ(stranger->create(path), ZNOAUTH) << path;
    for (const std::string path : {"/", "/zookeeper", "/zookeeper/quota", "/zookeeper/quota/iot/zookeeper_limits"})
      EXPECT_EQ(stranger->seize(path), ZNOAUTH) << path;
    EXPECT_EQ(stranger->set("/zookeeper/quota/iot/zookeeper_limits", "count=1,bytes=-1"), ZNOAUTH);
    EXPECT_EQ(stranger->remove("/zookeeper/quota/iot/zookeeper_limits"), ZNOAUTH);
    EXPECT_EQ(stranger->remove("/without-end-1"), ZNOAUTH);
  }
  for (const std::string path : {"/", "/zookeeper", "/iot", "/iot/gateways"}) {
    EXPECT_EQ(again.children(path), ZNOAUTH) << path;
    EXPECT_EQ(again.get(path), ZNOAUTH) << path;
  }
  EXPECT_EQ(again.exists("/iot/gateways/g1"), ZOK) << "what SECURITY.md says that it may still see";
  EXPECT_EQ(again.create("/kafka/brokers"), ZOK) << "others go on below what they have made";
  put(*gateway, paths_.gateway("g1"_gateway), "again");
  put(*master, paths_.submission("t"_topology), "submitted");
}

TEST_F(ServersOwnNodes, ThatSomebodyHasSeizedAreNamed) {
  const auto master = started_master();
  BareClient thief(server_.url(), "g2");
  ASSERT_EQ(thief.seize("/"), ZOK);
  ASSERT_EQ(thief.seize("/zookeeper/quota"), ZOK);
  const auto done = close();
  EXPECT_THAT(done.seized, ElementsAre("/", "/zookeeper/quota"));
  EXPECT_THAT(done.open, IsEmpty());
  EXPECT_EQ(thief.create("/zookeeper/more"), ZNOAUTH) << "the rest is closed";
}

/// SECURITY.md: the nodes of an Apache Storm, say, in the same ZooKeeper.
TEST_F(ServersOwnNodes, OfAnotherSystemWithoutRightsAreWrittenByTheThiefOfAGatewayAlsoOnceTheServersAreClosed) {
  const auto master = started_master();
  BareClient storm(server_.url(), "");
  ASSERT_EQ(storm.create("/storm"), ZOK);
  ASSERT_EQ(storm.create("/storm/assignments"), ZOK);
  ASSERT_TRUE(close().open.empty());
  BareClient thief(server_.url(), "g2");
  EXPECT_EQ(thief.get("/storm/assignments"), ZOK);
  EXPECT_EQ(thief.set("/storm/assignments", "other code"), ZOK);
  EXPECT_EQ(thief.seize("/storm"), ZOK);
}

/// SECURITY.md: all who come by the tunnel have one address at ZooKeeper.
TEST(ServersConnections, ThatADriverHostKeepsOpenShutItsGatewayOut) {
  constexpr int most = 5;
  const iotcloud::tests::PrivateServer server("zookeeper.py", {"--setting", "maxClientCnxns=" + std::to_string(most)});
  RegistryOptions options;
  options.url = server.url();
  const auto gateway_gets_in = [&] {
    try {
      return make_registry(options)->get("/").has_value();
    } catch (const RegistryError&) {
      return false;
    }
  };
  options.operation_timeout = std::chrono::milliseconds{500};
  ASSERT_TRUE(eventually(gateway_gets_in)) << "the server has just started";
  {
    std::vector<std::unique_ptr<BareClient>> held;
    while (held.size() < most) held.push_back(std::make_unique<BareClient>(server.url(), ""));
    options.operation_timeout = std::chrono::seconds{5};  // a busy machine is not what keeps it out
    EXPECT_FALSE(gateway_gets_in()) << "the attack, for which it needs no credential";
  }
  EXPECT_TRUE(eventually(gateway_gets_in)) << "once it is over";
}

TEST_F(ServersOwnNodes, AreNotClosedByOneWhoIsNoMasterThere) {
  RegistryOptions guessed = options_of("masters");
  guessed.password = "guessed";
  EXPECT_THROW(renew_rights(guessed, paths_, {}, ServersNodes::closed), config::Error) << "on an empty server";
  BareClient host(server_.url(), "");
  EXPECT_EQ(host.create("/still-open"), ZOK);
}

/// SECURITY.md, "What may be removed in the registry".
TEST_F(ServersOwnNodes, LimitNobodyWhoFillsWhatIsItsOwnUnlessAQuotaDoesWhichStopsTheHonestToo) {
  const auto master = started_master();
  const auto honest = member("g1");
  BareClient thief(server_.url(), "g2");
  const std::string own = paths_.gateway("g2"_gateway);
  ASSERT_EQ(thief.create(own), ZOK);
  const std::string much(std::size_t{500} * 1000, 'x');
  int nodes = 0;
  for (; nodes < 40; ++nodes) ASSERT_EQ(thief.create(own + "/" + std::to_string(nodes), much), ZOK) << "nobody says no";
  put(*honest, paths_.gateway("g1"_gateway), "what runs goes on");

  ASSERT_TRUE(close().open.empty());
  BareClient fellow(server_.url(), "masters");
  ASSERT_EQ(set_quota(fellow, "/iot", nodes + 20), ZOK);
  while (nodes < 80 && thief.create(own + "/" + std::to_string(nodes)) == ZOK) ++nodes;
  EXPECT_LT(nodes, 80);
  EXPECT_EQ(BareClient(server_.url(), "g1").create(paths_.gateway("g1"_gateway) + "/frozen"), over_quota);
  const auto alive = master->get(paths_.gateway("g1"_gateway));
  ASSERT_TRUE(alive);
  EXPECT_EQ(alive->data, "what runs goes on");
}

}  // namespace
}  // namespace iotcloud::discovery::tests
