// Access to the nodes that a process created in ZooKeeper: digest authentication.
#include <algorithm>
#include <memory>
#include <stdexcept>

#include <zookeeper/zookeeper.h>

#include <iotcloud/discovery/access.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/tests/discovery/contract_fixture.h>
#include <iotcloud/tests/discovery/fleet_users.h>
#include <iotcloud/tests/discovery/id_literals.h>

namespace iotcloud::discovery::tests {
namespace {

using Code = RegistryErrorCode;

class Access : public RegistryContract {
 protected:
  std::unique_ptr<Registry> as(const std::string& user, const std::string& password,
                               bool others_may_read = false) const {
    RegistryOptions options;
    options.url = place_->url() + "/guarded";
    options.operation_timeout = patience;
    options.user = user;
    options.password = password;
    options.others_may_read = others_may_read;
    return make_registry(options);
  }
};

TEST_P(Access, AUsersNodesAreForThoseWithItsPassword) {
  const auto owner = as("fleet", "secret: with a colon");
  owner->create("/a/b", "data");
  const auto held = owner->hold("/held", "data");
  const auto friendly = as("fleet", "secret: with a colon");
  EXPECT_EQ(friendly->get("/a/b")->data, "data");
  friendly->set("/a/b", "changed");
  const auto stranger = as("fleet", "guessed");
  const auto nobody = as("", "");
  for (Registry* other : {stranger.get(), nobody.get()}) {
    EXPECT_EQ(code_of([&] { other->get("/a/b"); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->set("/a/b", "stolen"); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->create("/a/c", ""); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->remove("/a/b"); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->get_all({"/a", "/a/b"}); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->children_of_all({"/a"}); }), Code::denied);
    EXPECT_EQ(code_of([&] { other->hold("/a/mine", ""); }), Code::denied);
  }
  EXPECT_EQ(owner->get("/a/b")->data, "changed");
}

TEST_P(Access, OthersMayReadWhenTheOwnerSaysSo) {
  const auto owner = as("fleet", "secret", true);
  owner->create("/a/b", "data");
  const auto nobody = as("", "");
  EXPECT_EQ(nobody->get("/a/b")->data, "data");
  EXPECT_EQ(nobody->children("/a")->size(), 1U);
  EXPECT_EQ(code_of([&] { nobody->set("/a/b", "stolen"); }), Code::denied);
  EXPECT_EQ(code_of([&] { nobody->create("/a/c", ""); }), Code::denied);
}

TEST_P(Access, AUserIsKnownAgainAfterAnExpiredSessionAndALostConnection) {
  const auto owner = as("fleet", "secret");
  Seen<std::string> created;
  const auto held = owner->hold("/held", "", false, [&](const auto& path) { created.add(path); });
  ASSERT_TRUE(created.wait_for_count(1));
  place_->expire(owner->get("/held")->owner_session);
  ASSERT_TRUE(created.wait_for_count(2));
  place_->stop();
  place_->start();
  EXPECT_TRUE(owner->get("/held"));
  EXPECT_EQ(code_of([&] { as("", "")->get("/held"); }), Code::denied);
}

TEST_P(Access, AWatchOfWhatBelongsToOthersWaitsUntilItMayBeRead) {
  const auto owner = as("fleet", "secret");
  owner->create("/shut", "");
  const auto nobody = as("", "");
  Seen<std::string> seen;
  const auto watch = nobody->watch_node("/shut", [&](const auto& node) { seen.add(text(node)); });
  owner->remove("/shut");
  EXPECT_TRUE(seen.wait_for_last("(none)"));
}

/// A fleet whose users have rights of their own: master, gateways g1 and g2, worker.
class FleetAccess : public Access {
 protected:
  FleetAccess() {
    use_all_but("");
    registry_->get("/");  // has made what is above the fleet's nodes, for everybody
  }
  /// From now on processes start with this list of users.
  void use_all_but(const std::string& name) {
    auto users = fleet_users();
    std::erase_if(users, [&](const RegistryUser& user) { return user.name == name; });
    access_ = std::make_shared<const RegistryAccess>(std::move(users), paths_);
  }
  std::unique_ptr<Registry> member(const std::string& user) const { return make_registry(options_of(user)); }
  /// A master, which has made the branches.
  std::unique_ptr<Registry> started_master() const {
    auto registry = member("masters");
    const auto kept = keep_branches(*registry, paths_);
    if (!eventually([&] { return has_branches(*registry); })) throw std::runtime_error("the branches are not made");
    return registry;
  }
  bool has_branches(Registry& registry) const {
    const auto nodes = registry.get_all(paths_.branches());
    return std::all_of(nodes.begin(), nodes.end(), [](const auto& node) { return node.has_value(); });
  }
  RegistryOptions options_of(const std::string& user) const {
    RegistryOptions options;
    options.url = place_->url() + "/fleet";
    options.operation_timeout = patience;
    options.user = user;
    options.password = fleet_password(user);
    options.access = access_;
    return options;
  }
  /// What a gateway writes, and a master orders.
  void live(Registry& gateway, const GatewayId& id, Registry& master) {
    put(gateway, paths_.gateway(id), "record");
    put(gateway, paths_.orders(id), "");
    put(gateway, paths_.channel("turtle"_driver, InstanceId(id.str()), "kinect"), "channel");
    put(gateway, paths_.instance("turtle"_driver, InstanceId(id.str())), "instance");
    put(master, paths_.order(id, "a"_instance), "order");
    put(master, paths_.removal(id, "a"_instance), "removal");
  }
  const Paths paths_;
  std::shared_ptr<const RegistryAccess> access_;
};

TEST_P(FleetAccess, TheThiefOfOneGatewaysCredentialsReachesThatGatewayOnly) {
  const auto master = started_master();
  const auto one = member("g1");
  const auto thief = member("g2");
  master->create(paths_.masters() + "/m1", "leads");
  live(*one, "g1"_gateway, *master);
  live(*thief, "g2"_gateway, *master);
  const auto held = one->hold(paths_.gateway_alive("g1"_gateway), "alive");

  const std::string order = paths_.order("g1"_gateway, "a"_instance);
  const std::string own_order = paths_.order("g2"_gateway, "a"_instance);
  const std::string removal = paths_.removal("g1"_gateway, "a"_instance);
  const std::string own_removal = paths_.removal("g2"_gateway, "a"_instance);
  const std::string instance = paths_.instance("turtle"_driver, "g1"_instance);
  const auto denied = [&](const std::function<void()>& call) { EXPECT_EQ(code_of(call), Code::denied); };
  denied([&] { thief->get(order); });
  denied([&] { thief->children(paths_.orders("g1"_gateway)); });
  denied([&] { thief->get(removal); });
  for (const std::string& path : {order, own_order, removal, own_removal, paths_.removals("g1"_gateway),
                                  paths_.orders("g1"_gateway), paths_.gateway("g1"_gateway), instance,
                                  instance + "/kinect", paths_.gateway_alive("g1"_gateway), paths_.masters() + "/m1"}) {
    denied([&] { thief->set(path, "stolen"); });
    denied([&] { thief->create(path + "/below", ""); });
  }
  denied([&] { thief->create(paths_.order("g1"_gateway, "b"_instance), "forged"); });
  denied([&] { thief->create(paths_.order("g2"_gateway, "b"_instance), "forged"); });
  denied([&] { thief->create(paths_.masters() + "/m0", "leads"); });
  denied([&] { thief->create(paths_.topology_order("t"_topology), "forged"); });
  for (const GatewayId& gateway : {"g1"_gateway, "g2"_gateway}) {
    denied([&] { thief->create(paths_.removal(gateway, "b"_instance), "forged"); });
  }
  for (const std::string& path : {order, own_order, removal, instance + "/kinect", paths_.gateway_alive("g1"_gateway)})
    denied([&] { thief->remove(path); });

  // Its own things it does as before, and reads what gateways read.
  EXPECT_EQ(thief->get(own_order)->data, "order");
  EXPECT_EQ(thief->get(own_removal)->data, "removal");
  thief->remove(own_removal);  // it has followed it
  put(*thief, paths_.gateway("g2"_gateway), "again");
  put(*thief, paths_.gateway("g2"_gateway) + "/frozen", "why");
  EXPECT_TRUE(thief->get(instance));
  remove_tree(*thief, paths_.instance("turtle"_driver, "g2"_instance));
  EXPECT_EQ(one->get(order)->data, "order");
}

TEST_P(FleetAccess, TheThiefOfAGatewaySeizesNoNodeOfOthersByTheBareClient) {
  const auto master = started_master();
  const auto one = member("g1");
  live(*one, "g1"_gateway, *master);
  live(*member("g2"), "g2"_gateway, *master);
  BareClient thief(options_of("g2").url, "g2");
  const std::string instance = paths_.instance("turtle"_driver, "g1"_instance);
  for (const std::string& path : {paths_.sensors, paths_.driver("turtle"_driver), paths_.gateways, instance,
                                  instance + "/kinect", paths_.gateway("g1"_gateway), paths_.orders("g1"_gateway),
                                  paths_.orders("g2"_gateway), paths_.order("g1"_gateway, "a"_instance),
                                  paths_.order("g2"_gateway, "a"_instance), paths_.removals("g2"_gateway)}) {
    EXPECT_EQ(thief.seize(path), ZNOAUTH) << path;
  }
  for (const std::string& path :
       {paths_.order("g1"_gateway, "b"_instance), paths_.order("g2"_gateway, "b"_instance), instance + "/arm",
        paths_.gateway("g1"_gateway) + "/frozen", paths_.masters() + "/m0", paths_.topologies + "/t",
        paths_.groups + "/t", paths_.pools + "/p1", paths_.submissions + "/t"}) {
    EXPECT_EQ(thief.create(path), ZNOAUTH) << path;
  }
  EXPECT_EQ(thief.seize(paths_.gateway("g2"_gateway)), ZOK) << "what is its own";
}

TEST_P(FleetAccess, TheThiefOfAGatewayOrOfAWorkerSeizesNoBranchByTheBareClient) {
  const auto master = started_master();
  const std::string above = paths_.sensors.substr(0, paths_.sensors.rfind('/'));
  for (const std::string& user : {std::string("g2"), std::string("workers")}) {
    BareClient thief(options_of(user).url, user);
    for (const std::string& branch : paths_.branches()) {
      EXPECT_EQ(thief.create(branch), ZNOAUTH) << user << " makes " << branch;
      EXPECT_EQ(thief.seize(branch), ZNOAUTH) << user << " takes " << branch;
    }
    EXPECT_EQ(thief.create(above + "/later"), ZNOAUTH) << "what a later version may need";
    EXPECT_EQ(thief.seize(above), ZNOAUTH);
  }
  Submission submission;
  submission.name = "t"_topology;
  put(*master, paths_.submission("t"_topology), encode(submission));
  EXPECT_EQ(list_topologies(*master, paths_).size(), 1U);
}

TEST_P(FleetAccess, AGatewayThatComesBeforeTheFirstMasterWaitsForIt) {
  const auto early = member("g1");
  EXPECT_EQ(code_of([&] { put(*early, paths_.gateway("g1"_gateway), "record"); }), Code::denied);
  const std::string above = paths_.sensors.substr(0, paths_.sensors.rfind('/'));
  EXPECT_EQ(BareClient(options_of("g2").url, "g2").create(above), ZNOAUTH) << "the thief of another";
  Seen<std::string> registered;
  const auto alive = early->hold_eventually(paths_.gateway_alive("g1"_gateway), "alive", false,
                                            [&](const auto& path) { registered.add(path); });
  const auto master = started_master();
  EXPECT_TRUE(registered.wait_for_count(1));
  put(*early, paths_.gateway("g1"_gateway), "record");
}

TEST_P(FleetAccess, AMasterMakesTheBranchesAgainWhenTheRegistryWasEmptied) {
  const auto master = member("masters");
  const auto kept = keep_branches(*master, paths_);
  ASSERT_TRUE(eventually([&] { return has_branches(*master); }));
  const auto session = session_of(*master);
  for (const std::string& branch : paths_.branches()) remove_tree(*master, branch);
  place_->expire(session);
  EXPECT_TRUE(eventually([&] { return has_branches(*master); }));
}

/// The nodes of an earlier version, under which whoever came first made the branches.
TEST_P(FleetAccess, ABranchThatAThiefHasSeizedIsTakenBackWhenTheRightsAreRenewed) {
  RegistryOptions open;
  open.url = options_of("").url;
  make_registry(open)->create(paths_.sensors, "");
  BareClient thief(options_of("g2").url, "g2");
  ASSERT_EQ(thief.create(paths_.submissions), ZOK);
  ASSERT_EQ(thief.create(paths_.pools), ZOK);
  ASSERT_EQ(thief.create(paths_.pool(PoolId("p1"))), ZOK);
  const auto master = member("masters");
  const auto submit = [&] { put(*master, paths_.submission("t"_topology), "submitted"); };
  EXPECT_EQ(code_of(submit), Code::denied) << "the attack";
  const auto done = renew_rights(options_of("masters"), paths_);
  EXPECT_THAT(done.removed, testing::ElementsAre(paths_.submissions));
  EXPECT_THAT(done.foreign, testing::ElementsAre(paths_.pools)) << "which has a node below";
  submit();
  EXPECT_EQ(thief.create(paths_.submissions + "/u"), ZNOAUTH);
  EXPECT_EQ(thief.seize(paths_.masters()), ZNOAUTH) << "a branch that comes after those, and that nobody had made";
}

TEST_P(FleetAccess, TheThiefOfAGatewayOrOfAWorkerKeepsMastersFromReadingItsOwnRecordsOnly) {
  const auto master = started_master();
  const auto one = member("g1");
  const auto two = member("g2");
  const auto worker = member("workers");
  for (const auto& [gateway, id] : {std::pair(one.get(), "g1"_gateway), std::pair(two.get(), "g2"_gateway)}) {
    live(*gateway, id, *master);
    GatewayRecord record;
    record.id = id;
    put(*gateway, paths_.gateway(id), encode(record));
    DriverRecord driver;
    driver.name = "turtle"_driver;
    driver.instance = InstanceId(id.str());
    driver.gateway = id;
    put(*gateway, paths_.instance(driver.name, driver.instance), encode(driver));
  }
  for (const TopologyName& name : {"t"_topology, "u"_topology}) {
    TopologyRecord record;
    record.name = name;
    put(*worker, paths_.topology(name), encode(record));
  }
  for (const std::string& id : {std::string("p1"), std::string("p2")}) {
    PoolRecord pool;
    put(*worker, paths_.pool(PoolId(id)), encode(pool));
  }
  BareClient thief(options_of("g2").url, "g2");
  for (const std::string& path : {paths_.gateway("g2"_gateway), paths_.instance("turtle"_driver, "g2"_instance)})
    ASSERT_EQ(thief.seize(path), ZOK) << path;
  ASSERT_EQ(thief.create(paths_.driver("lamp"_driver)), ZOK);
  BareClient other(options_of("workers").url, "workers");
  for (const std::string& path : {paths_.topology("u"_topology), paths_.pool(PoolId("p2"))})
    ASSERT_EQ(other.seize(path), ZOK) << path;

  const auto gateways = list_gateways(*master, paths_);
  ASSERT_EQ(gateways.size(), 1U);
  EXPECT_EQ(gateways[0].record.id, "g1"_gateway);
  const auto drivers = list_drivers(*master, paths_);
  ASSERT_EQ(drivers.size(), 1U);
  EXPECT_EQ(drivers[0].instance, "g1"_instance);
  EXPECT_EQ(list_topologies(*master, paths_).size(), 1U);
  EXPECT_EQ(list_pools(*master, paths_).size(), 1U);
}

TEST_P(FleetAccess, ANameThatAThiefHasSeizedBeforeAnybodyTookItIsFreeOnceTheRightsAreRenewed) {
  const auto master = started_master();
  const auto one = member("g1");
  live(*one, "g1"_gateway, *master);
  BareClient thief(options_of("g2").url, "g2");
  const std::string empty = paths_.driver("lamp"_driver), full = paths_.driver("heater"_driver);
  for (const std::string& path : {empty, full, full + "/1", paths_.gateway("g3"_gateway)})
    ASSERT_EQ(thief.create(path), ZOK) << path;
  const std::string pool = paths_.pool(PoolId("p1"));
  ASSERT_EQ(BareClient(options_of("workers").url, "workers").create(pool), ZOK) << "by the thief of a worker";
  const auto take = [&] { put(*one, paths_.instance("lamp"_driver, "g1"_instance), "record"); };
  EXPECT_EQ(code_of(take), Code::denied) << "the attack";
  const auto done = renew_rights(options_of("masters"), paths_);
  EXPECT_THAT(done.removed, testing::UnorderedElementsAre(empty, paths_.gateway("g3"_gateway), pool));
  EXPECT_THAT(done.foreign, testing::ElementsAre(full)) << "which it says";
  take();
  put(*one, paths_.instance("turtle"_driver, "g1"_instance), "as before");
}

TEST_P(FleetAccess, MastersMayDoEverythingAndWorkersTheirTopologiesOnly) {
  const auto master = started_master();
  const auto one = member("g1");
  const auto worker = member("workers");
  live(*one, "g1"_gateway, *master);
  const std::string workers = paths_.workers("t"_topology);
  const auto held = worker->hold(workers + "/w1", "here");
  worker->create(paths_.readers("t", "turtle"_driver, "kinect") + "/w1", "reads");
  put(*master, paths_.topology_order("t"_topology), "order");
  EXPECT_EQ(worker->get(paths_.topology_order("t"_topology))->data, "order");
  EXPECT_TRUE(worker->get(paths_.channel("turtle"_driver, "g1"_instance, "kinect")));
  const auto denied = [&](const std::function<void()>& call) { EXPECT_EQ(code_of(call), Code::denied); };
  denied([&] { worker->set(paths_.topology_order("t"_topology), "forged"); });
  const std::string removal = paths_.removal("g1"_gateway, "a"_instance);
  for (const std::string& path : {paths_.order("g1"_gateway, "a"_instance), removal}) {
    denied([&] { worker->get(path); });
    denied([&] { worker->set(path, "forged"); });
    denied([&] { worker->remove(path); });
  }
  denied([&] { worker->create(paths_.removal("g1"_gateway, "b"_instance), "forged"); });
  denied([&] { worker->set(paths_.instance("turtle"_driver, "g1"_instance), "forged"); });
  denied([&] { worker->create(paths_.gateway("g9"_gateway), "forged"); });
  denied([&] { worker->set(paths_.gateway("g1"_gateway), "forged"); });
  denied([&] { worker->set(paths_.channel("turtle"_driver, "g1"_instance, "kinect"), "forged"); });
  denied([&] { worker->remove(paths_.channel("turtle"_driver, "g1"_instance, "kinect")); });
  denied([&] { worker->create(paths_.gateway("g1"_gateway) + "/frozen", "forged"); });
  put(*master, paths_.submission("t"_topology), "submitted");
  put(*master, paths_.topology_history("t"_topology), "submitted once");
  EXPECT_EQ(worker->get(paths_.submission("t"_topology))->data, "submitted");
  for (const std::string& path : {paths_.submission("t"_topology), paths_.topology_history("t"_topology)}) {
    denied([&] { worker->set(path, "forged"); });
    denied([&] { worker->remove(path); });
  }
  denied([&] { worker->create(paths_.submissions + "/u", ""); });
  denied([&] { worker->create(paths_.submissions + "/t/other", ""); });
  worker->remove(paths_.topology_order("t"_topology));  // as the last one of a killed topology; SECURITY.md

  remove_tree(*master, paths_.sensors);
  remove_tree(*master, paths_.gateway("g1"_gateway));
  master->set(workers + "/w1", "changed");
  EXPECT_FALSE(one->get(paths_.gateway("g1"_gateway)));
}

TEST_P(FleetAccess, WhatTheThiefOfAGatewayStillMayIsWhatSecurityMdSays) {
  const auto master = started_master();
  const auto one = member("g1");
  const auto thief = member("g2");
  live(*one, "g1"_gateway, *master);
  const std::string bare = paths_.instance("turtle"_driver, "bare"_instance);
  put(*one, bare, "an instance without channels");
  thief->remove(bare);
  put(*thief, paths_.gateway("not-there-yet"_gateway), "a phantom");
  put(*thief, paths_.instance("turtle"_driver, "free"_instance), "a phantom");
  EXPECT_EQ(code_of([&] { thief->remove(paths_.instance("turtle"_driver, "g1"_instance)); }), Code::not_empty);
}

TEST_P(FleetAccess, TheThiefOfAGatewayReadsThePasswordThatAnotherOnesRecordHasInItsUrl) {
  const auto master = started_master();
  const auto one = member("g1");
  ChannelRecord channel;
  channel.name = "kinect";
  channel.transport = "rabbitmq";
  channel.broker_url = "amqp://robot:sesame@127.0.0.1:5672/";
  channel.gateway = "g1"_gateway;
  channel.driver = "turtle"_driver;
  channel.instance = "g1"_instance;
  const std::string path = paths_.channel(channel.driver, channel.instance, channel.name);
  put(*one, path, encode(channel));
  EXPECT_THAT(decode_channel(member("g2")->get(path)->data, path).broker_url, testing::HasSubstr("sesame"));
}

TEST_P(FleetAccess, TheThiefOfAGatewayHasAnInstanceListedTwiceByARecordWithItsId) {
  const auto master = started_master();
  const auto record_of = [](const DriverName& driver, const GatewayId& gateway) {
    DriverRecord record;
    record.name = driver;
    record.instance = "victim"_instance;
    record.gateway = gateway;
    return record;
  };
  const auto show = [&](Registry& by, const DriverRecord& record) {
    put(by, paths_.instance(record.name, record.instance), encode(record));
  };
  show(*member("g1"), record_of("turtle"_driver, "g1"_gateway));
  show(*member("g2"), record_of("aaa"_driver, "g2"_gateway));
  show(*member("g2"), record_of("bbb"_driver, "g1"_gateway));
  std::vector<std::string> listed;
  for (const auto& driver : list_drivers(*master, paths_))
    listed.push_back(driver.name.str() + " " + driver.instance.str() + " " + driver.gateway.str());
  EXPECT_THAT(listed, testing::UnorderedElementsAre("turtle victim g1", "aaa victim g2", "bbb victim g1"));
}

TEST_P(FleetAccess, AGatewayThatIsAddedLaterHasItsRightsOnceTheyAreRenewed) {
  use_all_but("g2");
  auto master = started_master();
  auto one = member("g1");
  live(*one, "g1"_gateway, *master);
  use_all_but("");
  const auto late = member("g2");
  EXPECT_EQ(code_of([&] { put(*late, paths_.gateway("g2"_gateway), "record"); }), Code::denied);
  std::size_t told = 0;
  const auto done = renew_rights(options_of("masters"), paths_, [&](std::size_t nodes) { told = nodes; });
  EXPECT_GT(done.changed, 0u);
  EXPECT_GE(done.nodes, done.changed);
  EXPECT_EQ(told, 0u) << "it tells of every thousandth";
  master = member("masters");
  live(*late, "g2"_gateway, *master);
  const std::string theirs = paths_.instance("turtle"_driver, "g1"_instance);
  EXPECT_TRUE(late->get(theirs));
  EXPECT_EQ(code_of([&] { late->set(theirs, "stolen"); }), Code::denied);
  EXPECT_EQ(code_of([&] { late->set(theirs + "/kinect", "stolen"); }), Code::denied);
  put(*one, theirs, "still its own");
  put(*one, theirs + "/kinect", "still its own");
  EXPECT_EQ(renew_rights(options_of("masters"), paths_).changed, 0u) << "each node has them already";
}

TEST_P(FleetAccess, AGatewayThatIsTakenFromTheListHasNoRightsOnceTheyAreRenewed) {
  auto master = started_master();
  const auto one = member("g1");
  const auto thief = member("g2");
  live(*one, "g1"_gateway, *master);
  live(*thief, "g2"_gateway, *master);
  use_all_but("g2");
  renew_rights(options_of("masters"), paths_);
  const auto denied = [&](const std::function<void()>& call) { EXPECT_EQ(code_of(call), Code::denied); };
  const std::string instance = paths_.instance("turtle"_driver, "g2"_instance);
  for (const std::string& path : {paths_.gateway("g2"_gateway), instance, instance + "/kinect", paths_.sensors}) {
    denied([&] { thief->get(path); });
    denied([&] { thief->set(path, "stolen"); });
    denied([&] { thief->create(path + "/below", ""); });
  }
  put(*one, paths_.instance("turtle"_driver, "g1"_instance), "as before");
}

/// SECURITY.md: daemons read the list of users when they start.
TEST_P(FleetAccess, AGatewayThatIsTakenFromTheListReadsWhatDaemonsMakeThatWereNotStartedAgain) {
  const auto master = started_master();
  const auto one = member("g1");
  use_all_but("g2");
  renew_rights(options_of("masters"), paths_);
  BareClient thief(options_of("g2").url, "g2");
  const std::string before = paths_.instance("turtle"_driver, "before"_instance);
  put(*one, before, "made by one that has the old list");
  EXPECT_EQ(thief.get(before), ZOK);
  const auto started_again = member("g1");
  const std::string after = paths_.instance("turtle"_driver, "after"_instance);
  put(*started_again, after, "made by one that has the new list");
  EXPECT_EQ(thief.get(after), ZNOAUTH);
  renew_rights(options_of("masters"), paths_);
  EXPECT_EQ(thief.get(before), ZNOAUTH) << "until the rights are renewed once more";
}

TEST_P(FleetAccess, RightsAreRenewedByAMasterWhomTheNodesKnow) {
  const auto master = started_master();
  const auto one = member("g1");
  live(*one, "g1"_gateway, *master);
  EXPECT_THROW(renew_rights(options_of("g1"), paths_), config::Error);
  auto wrong = options_of("masters");
  wrong.password = "guessed";
  try {
    renew_rights(wrong, paths_);
    FAIL() << "with a wrong password";
  } catch (const config::Error& e) {
    EXPECT_THAT(e.what(), testing::HasSubstr("does not let this user change its rights"));
  }
  wrong.url = "embedded://" + wrong.url.substr(wrong.url.rfind('/') + 1);
  EXPECT_THROW(renew_rights(wrong, paths_), config::Error);
}

INSTANTIATE_TEST_SUITE_P(Registries, FleetAccess, testing::Values("zookeeper"),
                         [](const auto& parameter) { return parameter.param; });
INSTANTIATE_TEST_SUITE_P(Registries, Access, testing::Values("zookeeper"),
                         [](const auto& parameter) { return parameter.param; });

}  // namespace
}  // namespace iotcloud::discovery::tests
