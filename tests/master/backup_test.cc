// Backups of what is ordered: taken out of the registry, and put into one that lost it.
#include <limits>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/freeze.h>
#include <iotcloud/master/orders/backup_file.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::OrderRecord;
using discovery::TopologyOrder;
using test::FakeGateway;
using test::TestMaster;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

class MasterBackup : public testing::Test {
 protected:
  MasterBackup() { EXPECT_TRUE(master.leads()); }
  void deploy(const char* gateway, const char* name, int count = 1) {
    DeployRequest request;
    request.plugin = "turtle.so";
    request.name = name;
    request.count = count;
    request.gateways = {discovery::GatewayId(gateway)};
    request.properties = {{"password", "sesame"}};
    const auto result = master->deploy(request);
    ASSERT_TRUE(result.all_done()) << result.summary();
  }
  OrderResult import(const Backup& backup, bool replace = false) {
    return master->give("import", discovery::to_json<nlohmann::json>(ImportRequest{backup, replace}).dump()).result;
  }
  void order_topology(std::int64_t revision, bool active) {
    TopologyOrder order;
    order.revision = revision;
    order.active = active;
    discovery::put(*registry, paths.topology_order("t"_topology), encode(order));
  }
  TopologyOrder topology_order() const {
    const auto path = paths.topology_order("t"_topology);
    return discovery::decode_topology_order(registry->get(path).value().data, path);
  }
  void wipe() {
    discovery::remove_tree(*registry, paths.gateways);
    discovery::remove_tree(*registry, paths.topologies);
    discovery::remove_tree(*registry, paths.submissions);
  }
  /// What stands in the registry now, without what differs between masters and times.
  Backup standing() {
    auto backup = master->backup();
    backup.made_ms = 0;
    for (auto& gateway : backup.gateways) {
      for (auto& order : gateway.orders) order.epoch = 0;
    }
    for (auto& topology : backup.topologies)
      topology.order = {0, 0, topology.order.active, topology.order.parallelism, {}};
    return backup;
  }

  const std::string url = test::fresh_registry_url();
  const std::unique_ptr<discovery::Registry> registry = test::open_registry(url);
  const discovery::Paths paths;
  TestMaster master{url};
};

TEST_F(MasterBackup, HasWhatIsOrderedAndIsReadAgain) {
  FakeGateway one(url, "lab1"), two(url, "lab2");
  deploy("lab1", "robot", 2);
  deploy("lab2", "meter");
  GatewaySelection drained;
  drained.gateways = {"lab2"_gateway};
  ASSERT_TRUE(master->drain(drained).all_done());
  order_topology(3, false);
  const auto backup = master->backup();
  ASSERT_THAT(backup.gateways, SizeIs(2));
  ASSERT_THAT(backup.gateways[0].orders, SizeIs(2));
  EXPECT_FALSE(backup.gateways[0].draining);
  EXPECT_EQ(backup.gateways[0].orders[1].index, 2);
  EXPECT_EQ(backup.gateways[0].orders[1].properties.at("password"), "sesame");
  EXPECT_TRUE(backup.gateways[1].draining);
  ASSERT_THAT(backup.topologies, SizeIs(1));
  EXPECT_FALSE(backup.topologies[0].order.active);
  EXPECT_GT(backup.made_ms, 0);
  EXPECT_EQ(decode_backup(encode(backup), "b"), backup);
  EXPECT_EQ(words(backup), "3 orders of 2 gateways, 1 of topologies");
}

TEST_F(MasterBackup, GivesAnEmptiedRegistryItsOrdersBack) {
  order_topology(3, false);
  {
    FakeGateway gateway(url, "lab1");
    deploy("lab1", "robot", 2);
    GatewaySelection drained;
    drained.gateways = {"lab1"_gateway};
    ASSERT_TRUE(master->drain(drained).all_done());
  }
  const auto before = standing();
  const auto backup = master->backup();
  wipe();
  ASSERT_THAT(standing().gateways, IsEmpty());
  const auto result = import(backup);
  EXPECT_TRUE(result.all_done()) << result.summary();
  ASSERT_THAT(result.outcomes, SizeIs(3));
  EXPECT_THAT(result.outcomes[0].reason, HasSubstr("not registered"));
  EXPECT_EQ(result.outcomes[2].instance, "topologies/t");
  EXPECT_EQ(master->orders().at(0).order.epoch, master->status().epoch);
  FakeGateway again(url, "lab1");
  EXPECT_EQ(standing(), before);
  EXPECT_TRUE(again.wait_for_orders(2));
}

TEST_F(MasterBackup, LeavesWhatStandsThereUnlessItIsToReplaceIt) {
  FakeGateway gateway(url, "lab1");
  deploy("lab1", "robot");
  order_topology(3, false);
  const auto backup = master->backup();
  for (const auto& outcome : import(backup).outcomes) EXPECT_EQ(outcome.reason, "it stood there already");
  DeploymentChange change;
  change.instances = {backup.gateways.at(0).orders.at(0).instance};
  change.properties = std::map<std::string, std::string>{{"password", "other"}};
  ASSERT_TRUE(master->change_deployment(change).all_done());
  deploy("lab1", "meter");
  order_topology(4, true);

  const auto left = import(backup);
  for (const auto& outcome : left.outcomes) {
    EXPECT_EQ(outcome.outcome, OrderOutcome::failed);
    EXPECT_THAT(outcome.reason, HasSubstr("--replace"));
  }
  EXPECT_EQ(gateway.orders().size(), 2U);
  EXPECT_TRUE(topology_order().active);

  const auto replaced = import(backup, true);
  EXPECT_TRUE(replaced.all_done()) << replaced.summary();
  EXPECT_EQ(standing().gateways.at(0).orders.size(), 2U) << "what the backup does not have stays";
  EXPECT_EQ(standing().gateways.at(0).orders.at(1).properties.at("password"), "sesame");
  EXPECT_FALSE(topology_order().active);
  EXPECT_EQ(topology_order().revision, 5) << "workers follow newer orders only";
}

TEST_F(MasterBackup, AnOrderOfATopologyIsNewerThanWhatItsWorkersFollow) {
  order_topology(3, false);
  const auto backup = master->backup();
  wipe();
  discovery::WorkerRecord worker;
  worker.name = "w1";
  worker.revision = 7;
  const auto lives = registry->hold(paths.workers("t"_topology) + "/w1", encode(worker));
  EXPECT_TRUE(import(backup).all_done());
  EXPECT_EQ(topology_order().revision, 8);
}

TEST_F(MasterBackup, DoesNotBringAKilledTopologyBack) {
  TopologyOrder order;
  order.revision = 2;
  order.kill = discovery::TopologyKill{{"w1"}, 1, 1};
  discovery::put(*registry, paths.topology_order("t"_topology), encode(order));
  EXPECT_THAT(master->backup().topologies, IsEmpty());
}

TEST_F(MasterBackup, GivesAnEmptiedRegistryItsSubmittedTopologiesBack) {
  const auto submit = [&](const std::string& yaml) {
    discovery::Submission submission;
    submission.name = "t"_topology;
    submission.workers = 3;
    submission.last_number = 4;
    submission.pending = 1;
    submission.version = {4, yaml, {{"x.so", "x.so", std::string(64, 'a')}}, "digest"};
    submission.previous = {3, "before", {}, ""};
    discovery::put(*registry, paths.submission("t"_topology), encode(submission));
  };
  submit("one");
  const auto backup = master->backup();
  ASSERT_THAT(backup.submissions, SizeIs(1));
  EXPECT_THAT(sent_libraries(backup), SizeIs(1));
  EXPECT_EQ(decode_backup(encode(backup), "b"), backup);
  wipe();
  EXPECT_TRUE(import(backup).all_done());
  auto standing = discovery::list_submissions(*registry, paths).at("t"_topology).submission;
  EXPECT_EQ(standing.version.yaml, "one");
  EXPECT_EQ(standing.version.number, 5) << "pools may remember another version 4";
  EXPECT_EQ(standing.workers, 3);
  EXPECT_EQ(standing.pending, 0);
  submit("another");
  EXPECT_FALSE(import(backup).all_done());
  EXPECT_TRUE(import(backup, true).all_done());
  standing = discovery::list_submissions(*registry, paths).at("t"_topology).submission;
  EXPECT_EQ(standing.version.yaml, "one");
}

TEST_F(MasterBackup, WhatCannotBeReadIsRefusedAndNothingIsWritten) {
  Backup backup;
  OrderRecord order;
  order.plugin = "turtle.so";
  order.instance = "a"_instance;
  backup.gateways = {{"lab1"_gateway, false, {order}}, {"../masters"_gateway, true, {order}}};
  auto refused = import(backup);
  EXPECT_EQ(refused.refusal, OrderRefusal::bad_request);
  EXPECT_THAT(refused.text, HasSubstr("\"../masters\" cannot be the id of a gateway"));
  backup.gateways.pop_back();
  backup.format = 2;
  refused = import(backup);
  EXPECT_THAT(refused.text, HasSubstr("its format is 2"));
  EXPECT_THAT(master->orders(), IsEmpty());
  EXPECT_THROW(decode_backup("{", "b"), config::Error);
  EXPECT_THROW(decode_backup("{}", "b"), config::Error) << "it says no format";
}

TEST(BackupFile, NestingThatWouldOverflowTheStackIsRefused) {
  const auto deep = [](const std::string& before, std::size_t levels) {
    return before + R"("new":)" + std::string(levels, '[') + std::string(levels, ']');
  };
  const std::string file = R"({"format":1,)", order = R"({"instance":"a","plugin":"turtle.so",)";
  const std::string gateway = file + R"("gateways":[{"gateway":"lab1","orders":[)" + order;
  EXPECT_NO_THROW(decode_backup(deep(file, 10) + "}", "b")) << "a newer program may say more";
  EXPECT_NO_THROW(decode_backup(deep(gateway, 10) + "}]}]}", "b"));
  for (const std::string& text : {deep(file, 100'000) + "}", deep(gateway, 100'000) + "}]}]}"}) {
    try {
      decode_backup(text, "b");
      ADD_FAILURE() << "it was read: " << text.substr(0, 100);
    } catch (const config::Error& error) {
      EXPECT_THAT(error.what(), testing::AllOf(HasSubstr("b: "), HasSubstr("levels")));
    }
  }
}

TEST(BackupFile, IsCutIntoPiecesThatHaveAllOfIt) {
  Backup backup;
  OrderRecord order;
  order.plugin = "turtle.so";
  order.metadata["text"] = std::string(1000, 'x');
  for (int i = 0; i < 5; ++i) {
    order.instance = discovery::InstanceId(std::to_string(i));
    const auto gateway = i < 3 ? "lab1"_gateway : "lab2"_gateway;
    if (backup.gateways.empty() || backup.gateways.back().gateway != gateway)
      backup.gateways.push_back({gateway, i == 3, {}});
    backup.gateways.back().orders.push_back(order);
  }
  backup.topologies.push_back({"t"_topology, {}});
  const auto pieces = pieces_of(backup, 2500);
  std::vector<std::string> found;
  for (const auto& piece : pieces) {
    std::size_t size = 0;
    for (const auto& gateway : piece.gateways) {
      EXPECT_EQ(gateway.draining, gateway.gateway == "lab2"_gateway);
      for (const auto& each : gateway.orders) {
        found.push_back(gateway.gateway + "/" + each.instance);
        size += encode(each).size();
      }
    }
    EXPECT_LE(size, 2500U);
  }
  EXPECT_THAT(found, ElementsAre("lab1/0", "lab1/1", "lab1/2", "lab2/3", "lab2/4"));
  EXPECT_THAT(pieces, SizeIs(3));
  EXPECT_THAT(pieces.back().topologies, SizeIs(1));
  EXPECT_THAT(pieces_of(backup, 1), SizeIs(8)) << "one order each, and one of each gateway's mark";
  EXPECT_THAT(pieces_of({}, 2500), IsEmpty());
}

/// A seal that every reader of JSON passes over.
std::string seal(const std::string& path, const std::string& bytes) {
  return bytes.substr(0, bytes.size() - 1) + R"(,"signature":")" + path + "\"}";
}

TEST(MasterSeal, OrdersToTopologiesHaveItToo) {
  auto options = TestMaster::quick();
  options.seal = seal;
  TestMaster master(test::fresh_registry_url(), options);
  ASSERT_TRUE(master.leads());
  const discovery::Paths paths;
  const auto path = paths.topology_order("t"_topology);
  auto& registry = master.registry();
  const auto standing = [&] { return registry.get(path).value(); };
  TopologyOrder unsealed;
  unsealed.revision = 3;
  discovery::put(registry, paths.topology("t"_topology), encode(discovery::TopologyRecord{"t"_topology, 0, {}, {}}));
  discovery::put(registry, path, encode(unsealed));

  const auto import = [&](bool replace) {
    ImportRequest request{master->backup(), replace};
    return master->give("import", discovery::to_json<nlohmann::json>(request).dump()).result;
  };
  EXPECT_TRUE(import(false).all_done());
  EXPECT_EQ(standing().data, encode(unsealed)) << "what stands there is taken over only if a person says so";
  EXPECT_TRUE(import(true).all_done());
  EXPECT_THAT(standing().data, testing::EndsWith(R"(,"signature":")" + path + "\"}"));

  TopologyRequest request;
  request.topology = "t"_topology;
  request.change = TopologyChange::deactivate;
  const auto before = discovery::decode_topology_order(standing().data, path);
  ASSERT_TRUE(master->order(request).all_done());
  EXPECT_THAT(standing().data, testing::EndsWith(R"(,"signature":")" + path + "\"}"));
  const auto order = discovery::decode_topology_order(standing().data, path);
  EXPECT_FALSE(order.active);
  EXPECT_GE(order.given_ms, before.given_ms);
  EXPECT_GT(before.given_ms, 0);
}

TEST(MasterSeal, EveryOrderIsWrittenWithItsSealAlsoWhenItIsChangedOrImported) {
  const std::string url = test::fresh_registry_url();
  const auto registry = test::open_registry(url);
  const discovery::Paths paths;
  std::string first;  // the path of the first order
  const auto standing = [&](const std::string& path) { return registry->get(path).value().data; };
  Backup backup;
  {
    TestMaster unsealed(url);
    ASSERT_TRUE(unsealed.leads());
    FakeGateway gateway(url, "lab1");
    DeployRequest request;
    request.plugin = "turtle.so";
    ASSERT_TRUE(unsealed->deploy(request).all_done());
    backup = unsealed->backup();
    first = paths.order("lab1"_gateway, backup.gateways.at(0).orders.at(0).instance);
  }
  auto options = TestMaster::quick();
  options.seal = seal;
  TestMaster master(url, options);
  ASSERT_TRUE(master.leads());
  FakeGateway gateway(url, "lab1");
  const auto is_sealed = [&](const std::string& path) {
    return standing(path).ends_with(R"(,"signature":")" + path + "\"}");
  };
  EXPECT_FALSE(is_sealed(first));
  const auto import = [&](bool replace) {
    return master->give("import", discovery::to_json<nlohmann::json>(ImportRequest{backup, replace}).dump()).result;
  };
  EXPECT_TRUE(import(false).all_done());
  EXPECT_FALSE(is_sealed(first)) << "what stands there is taken over only if a person says so";
  EXPECT_TRUE(import(true).all_done());
  EXPECT_TRUE(is_sealed(first));

  DeployRequest request;
  request.plugin = "turtle.so";
  const auto deployed = master->deploy(request);
  ASSERT_TRUE(deployed.all_done()) << deployed.summary();
  const auto second = paths.order("lab1"_gateway, deployed.outcomes.at(0).instance);
  EXPECT_TRUE(is_sealed(second));
  InstanceSelection stop;
  stop.instances = {deployed.outcomes.at(0).instance};
  ASSERT_TRUE(master->stop(stop).all_done());
  EXPECT_TRUE(is_sealed(second));
  EXPECT_EQ(standing(second).find("signature"), standing(second).rfind("signature")) << "one seal, not two";

  const auto order = discovery::decode_order(standing(second), second);
  EXPECT_GT(order.given_ms, 0);
  ASSERT_TRUE(master->undeploy(stop).all_done());
  const auto removed = paths.removal("lab1"_gateway, order.instance);
  EXPECT_TRUE(is_sealed(removed));
  const auto removal = discovery::decode_removal(standing(removed), removed);
  EXPECT_EQ(removal.instance, order.instance);
  EXPECT_GT(removal.given_ms, order.given_ms);
}

/// A master that trusts the seals of masters, in a registry in which somebody else has written.
class ForeignOrders : public testing::Test {
 protected:
  static MasterOptions with_seal() {
    auto options = TestMaster::quick();
    options.seal = seal;
    options.is_sealed = [](const std::string& path, const std::string& bytes) {
      return bytes.ends_with(R"(,"signature":")" + path + "\"}");
    };
    return options;
  }
  bool is_sealed(const std::string& path) { return with_seal().is_sealed(path, standing(path)); }
  /// Selects the one instance that this deploys.
  InstanceSelection deploy_one(const std::map<std::string, std::string>& properties = {}) {
    DeployRequest request;
    request.plugin = "turtle.so";
    request.properties = properties;
    const auto deployed = master_->deploy(request);
    EXPECT_TRUE(deployed.all_done()) << deployed.summary();
    InstanceSelection selection;
    selection.instances = {deployed.outcomes.at(0).instance};
    return selection;
  }
  /// An instance that was deployed and then stopped, and its order from before it was stopped.
  struct Stopped {
    InstanceSelection selection;
    std::string path, old;
  };
  Stopped deploy_and_stop() {
    const InstanceSelection selection = deploy_one();
    const auto path = paths_.order("lab1"_gateway, selection.instances.at(0));
    const auto old = standing(path);
    EXPECT_TRUE(master_->stop(selection).all_done());
    return {selection, path, old};
  }
  std::string standing(const std::string& path) { return master_.registry().get(path).value().data; }
  void write(const std::string& path, const std::string& bytes) { discovery::put(master_.registry(), path, bytes); }

  const std::string url_ = test::fresh_registry_url();
  const discovery::Paths paths_;
  TestMaster master_{url_, with_seal()};
  FakeGateway gateway_{url_, "lab1"};
};

TEST_F(ForeignOrders, AreNotSignedBecauseSomebodyChangesThem) {
  ASSERT_TRUE(master_.leads());
  const InstanceSelection selection = deploy_one();
  const auto path = paths_.order("lab1"_gateway, selection.instances.at(0));
  const auto backup = master_->backup();
  auto forged = discovery::decode_order(standing(path), path);
  forged.plugin = "evil.so";
  forged.driver = "turtle"_driver;  // the instance has one record, whichever of the two orders its gateway saw last
  forged.epoch = forged.given_ms = std::numeric_limits<std::int64_t>::max();
  write(path, encode(forged));

  DeploymentChange change;
  change.instances = selection.instances;
  change.properties = std::map<std::string, std::string>{{"rate", "9"}};
  for (const auto& result : {master_->stop(selection), master_->start(selection), master_->change_deployment(change)}) {
    ASSERT_THAT(result.outcomes, SizeIs(1)) << result.summary();
    EXPECT_EQ(result.outcomes.front().outcome, OrderOutcome::failed);
    EXPECT_THAT(result.outcomes.front().reason, testing::HasSubstr("no trusted master has signed the order"));
  }
  EXPECT_EQ(standing(path), encode(forged));

  const ImportRequest import{backup, true};
  EXPECT_TRUE(master_->give("import", discovery::to_json<nlohmann::json>(import).dump()).result.all_done());
  EXPECT_TRUE(is_sealed(path)) << "a person may put what was there in its place";
  EXPECT_EQ(discovery::decode_order(standing(path), path).plugin, "turtle.so");
  EXPECT_LT(discovery::decode_order(standing(path), path).given_ms, forged.given_ms);

  write(path, encode(forged));
  ASSERT_TRUE(master_->undeploy(selection).all_done()) << "and take it away";
  const auto removed = paths_.removal("lab1"_gateway, selection.instances.front());
  EXPECT_TRUE(is_sealed(removed));
  EXPECT_LT(discovery::decode_removal(standing(removed), removed).given_ms, forged.given_ms);
}

TEST_F(ForeignOrders, ThatAMasterSignedLongAgoAreNotSignedAnewBecauseSomebodyChangesThem) {
  ASSERT_TRUE(master_.leads());
  const InstanceSelection selection = deploy_one({{"rate", "1"}});
  const auto path = paths_.order("lab1"_gateway, selection.instances.at(0));
  const auto old = standing(path);
  const auto expect_refused = [&] {
    for (const auto& result : {master_->stop(selection), master_->start(selection)}) {
      ASSERT_THAT(result.outcomes, SizeIs(1)) << result.summary();
      EXPECT_EQ(result.outcomes.front().outcome, OrderOutcome::failed);
      EXPECT_THAT(result.outcomes.front().reason, testing::HasSubstr("somebody wrote an old one once more"));
    }
    EXPECT_EQ(standing(path), old);
  };
  DeploymentChange change;
  change.instances = selection.instances;
  change.properties = std::map<std::string, std::string>{{"rate", "9"}};
  ASSERT_TRUE(master_->change_deployment(change).all_done());
  const auto backup = master_->backup();
  write(path, old);
  expect_refused();

  const ImportRequest import{backup, true};
  EXPECT_TRUE(master_->give("import", discovery::to_json<nlohmann::json>(import).dump()).result.all_done());
  EXPECT_EQ(discovery::decode_order(standing(path), path).properties.at("rate"), "9");
  EXPECT_TRUE(master_->stop(selection).all_done()) << "the order that a person put there may be changed";

  ASSERT_TRUE(master_->undeploy(selection).all_done());
  write(path, old);
  expect_refused();
}

TEST_F(ForeignOrders, ThatAPersonAdoptsAsTheyStandAreChangedAgain) {
  ASSERT_TRUE(master_.leads());
  const auto [selection, path, old] = deploy_and_stop();
  write(path, old);  // the registry was put back to an earlier state, and the gateway is frozen
  const auto mark = discovery::freeze_path(paths_, "lab1"_gateway);
  write(mark, encode(discovery::FreezeRecord{"it was put back", 5, "token"}));
  EXPECT_FALSE(master_->stop(selection).all_done());
  EXPECT_EQ(standing(path), old);
  master_->give("adopt", R"({"gateways": ["lab1"], "wait_ms": 1})");
  ASSERT_TRUE(master_.registry().remove(mark));
  EXPECT_TRUE(master_->stop(selection).all_done());
}

TEST_F(ForeignOrders, ThatAPersonAdoptsAreChangedAgainAlsoByAMasterThatDidNotThawTheGateway) {
  ASSERT_TRUE(master_.leads());
  const auto [selection, path, old] = deploy_and_stop();
  write(path, old);  // another master led meanwhile, and adopted the registry that was put back
  const auto refused = master_->stop(selection);
  ASSERT_THAT(refused.outcomes, SizeIs(1)) << refused.summary();
  EXPECT_THAT(refused.outcomes.front().reason, HasSubstr("`iotcloud registry adopt lab1`"));
  const auto adopted = master_->give("adopt", R"({"gateways": ["lab1"]})").result;
  EXPECT_THAT(adopted.outcomes.at(0).reason, HasSubstr("not frozen"));
  EXPECT_TRUE(master_->stop(selection).all_done());
}

TEST_F(ForeignOrders, ThatWereWrittenLongAfterTheyWereGivenAreNotChangedByAnAdoption) {
  ASSERT_TRUE(master_.leads());
  const auto [selection, path, old] = deploy_and_stop();
  auto order = discovery::decode_order(old, path);
  order.given_ms -= std::chrono::milliseconds(std::chrono::minutes(11)).count();
  write(path, seal(path, encode(order)));
  for (const char* when : {"before", "after"}) {
    const auto refused = master_->stop(selection);
    ASSERT_THAT(refused.outcomes, SizeIs(1)) << refused.summary();
    EXPECT_THAT(refused.outcomes.front().reason, HasSubstr("somebody wrote an old one once more")) << when;
    EXPECT_THAT(refused.outcomes.front().reason, testing::Not(HasSubstr("registry adopt"))) << when;
    master_->give("adopt", R"({"gateways": ["lab1"]})");
  }
}

TEST_F(ForeignOrders, ThatAMasterSignedLongAgoEndWithARemovalThatIsLaterThanWhatItGaveLast) {
  ASSERT_TRUE(master_.leads());
  const InstanceSelection selection = deploy_one();
  const auto path = paths_.order("lab1"_gateway, selection.instances.at(0));
  const auto old = standing(path);
  auto ahead = discovery::decode_order(old, path);  // of a master whose clock is an hour ahead
  ahead.given_ms += std::chrono::milliseconds(std::chrono::hours(1)).count();
  write(path, seal(path, encode(ahead)));
  ASSERT_TRUE(master_->stop(selection).all_done());
  const auto last = discovery::decode_order(standing(path), path).given_ms;
  ASSERT_GT(last, ahead.given_ms);
  write(path, old);
  ASSERT_TRUE(master_->undeploy(selection).all_done());
  const auto removed = paths_.removal("lab1"_gateway, selection.instances.front());
  EXPECT_GT(discovery::decode_removal(standing(removed), removed).given_ms, last);
}

TEST_F(ForeignOrders, ThatWereSignedLongBeforeTheyWereWrittenAreNotSignedByAMasterWithoutAMemoryOfThem) {
  ASSERT_TRUE(master_.leads());
  const InstanceSelection selection = deploy_one();
  const auto path = paths_.order("lab1"_gateway, selection.instances.at(0));
  auto order = discovery::decode_order(standing(path), path);
  master_.end();
  TestMaster next(url_, with_seal());
  ASSERT_TRUE(next.leads());
  ASSERT_TRUE(next->stop(selection).all_done()) << "what another master gave a moment ago may be changed";

  TestMaster third(url_, with_seal());
  next.end();
  ASSERT_TRUE(third.leads());
  order.given_ms -= std::chrono::milliseconds(std::chrono::minutes(11)).count();
  discovery::put(third.registry(), path, seal(path, encode(order)));
  const auto stopped = third->stop(selection);
  ASSERT_THAT(stopped.outcomes, SizeIs(1)) << stopped.summary();
  EXPECT_THAT(stopped.outcomes.front().reason, testing::HasSubstr("somebody wrote an old one once more"));
  EXPECT_THAT(stopped.outcomes.front().reason, testing::Not(HasSubstr("adopt"))) << "which would not help";
}

TEST_F(ForeignOrders, ToTopologiesThatAMasterSignedLongAgoLeaveNothingInTheNextOne) {
  ASSERT_TRUE(master_.leads());
  const auto path = paths_.topology_order("t"_topology);
  write(paths_.topology("t"_topology), encode(discovery::TopologyRecord{"t"_topology, 0, {}, {}}));
  TopologyRequest request;
  request.topology = "t"_topology;
  request.change = TopologyChange::deactivate;
  ASSERT_TRUE(master_->order(request).all_done());
  auto old = discovery::decode_topology_order(standing(path), path);
  --old.given_ms;
  old.parallelism = {{"work", 1000}};
  write(path, seal(path, encode(old)));
  request.change = TopologyChange::activate;
  const auto activated = master_->order(request);
  ASSERT_TRUE(activated.all_done());
  EXPECT_THAT(activated.text, HasSubstr("is forgotten, with the parallelism"));
  EXPECT_THAT(discovery::decode_topology_order(standing(path), path).parallelism, IsEmpty());
  EXPECT_THAT(master_->order(request).text, testing::Not(HasSubstr("forgotten")));
}

TEST_F(ForeignOrders, ToTopologiesLeaveNothingInTheNextOne) {
  ASSERT_TRUE(master_.leads());
  const auto path = paths_.topology_order("t"_topology);
  write(paths_.topology("t"_topology), encode(discovery::TopologyRecord{"t"_topology, 0, {}, {}}));
  TopologyOrder forged;
  forged.revision = forged.epoch = forged.given_ms = std::numeric_limits<std::int64_t>::max();
  forged.parallelism = {{"work", 1000}};
  write(path, encode(forged));
  TopologyRequest request;
  request.topology = "t"_topology;
  request.change = TopologyChange::deactivate;
  ASSERT_TRUE(master_->order(request).all_done());
  EXPECT_TRUE(is_sealed(path));
  const auto order = discovery::decode_topology_order(standing(path), path);
  EXPECT_FALSE(order.active);
  EXPECT_THAT(order.parallelism, IsEmpty());
  EXPECT_LT(order.given_ms, forged.given_ms);
}

}  // namespace
}  // namespace iotcloud::master
