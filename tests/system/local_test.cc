#include <atomic>
#include <chrono>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/system/pinger.h>
#include <iotcloud/topology/bolt.h>
#include <iotcloud/topology/local/local_cluster.h>

namespace iotcloud::tests {
namespace {

using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::StartsWith;
using topology::BasicOutputCollector;
using topology::Payload;
using topology::Tuple;
using topology::Values;

constexpr const char* round_trip = R"(
topology.name: round_trip
spouts:
  ping:
    broker: rabbitmq
    driver: pinger
    channel: ping
    fields: [ping, driverID, time]
    parallelism: 2
bolts:
  work:
    class: test.Work
    parallelism: 2
    inputs: [{from: ping, grouping: fields, fields: [driverID]}]
  pong:
    broker: rabbitmq
    driver: pinger
    channel: pong
    fields: [pong, driverID, time]
    inputs: {from: work}
)";

/// How often Work throws before it lets a message with an odd number pass; how many it saw.
std::atomic<int> throws_left{0};

class Work : public topology::BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(topology::Fields{"pong", "driverID", "time"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    if (throws_left.load() > 0 && throws_left.fetch_sub(1) > 0) throw std::runtime_error("not today");
    collector.emit(Values(tuple.at("ping"), tuple.at("driverID"), tuple.at("time")));
  }
};

/// Sets a property: whether the message's number is even; of every third message neither.
class Judge : public topology::BasicBolt {
 public:
  void declare_output_fields(topology::OutputFieldsDeclarer& declarer) const override {
    declarer.declare(topology::Fields{"pong", "driverID", "time", "verdict"});
  }
  void execute(const Tuple& tuple, BasicOutputCollector& collector) override {
    const std::string text(tuple.get<Payload>("ping").text());
    const int number = std::stoi(text.substr(text.rfind(' ')));
    Values values(tuple.at("ping"), tuple.at("driverID"), tuple.at("time"));
    values.add(number % 3 == 0 ? topology::Value{} : topology::Value{std::string(number % 2 == 0 ? "even" : "odd")});
    collector.emit(std::move(values));
  }
};

/// A pinger that reads the property `judged` of what it gets.
class JudgedPinger final : public Pinger {
 public:
  void on_message(std::string_view, drivers::Message message) override {
    const std::string* judged = message.properties.find("judged");
    Answers::get().add(message.driver_id,
                       std::string(message.payload.text()) + (judged != nullptr ? " is " + *judged : ""));
  }
  static const drivers::Descriptor* descriptor() {
    static const auto descriptor = drivers::describe<JudgedPinger>("judged", "1.0");
    return &descriptor;
  }
};

class LocalMode : public ::testing::Test {
 protected:
  LocalMode() {
    throws_left = 0;
    static std::atomic<int> number{0};
    options.name = "local-test-" + std::to_string(++number);  // tests do not see each other's servers
    options.drivers = {{"pinger", Pinger::descriptor()}, {"judged", JudgedPinger::descriptor()}};
    options.metrics = &metrics;
  }
  topology::Worker& run(local::LocalCluster& cluster, const std::string& yaml = round_trip) {
    topology::ComponentRegistry components;
    components.add_bolt<Work>("test.Work");
    components.add_bolt<Judge>("test.Judge");
    return cluster.run_topology(topology::TopologyDefinition::parse(yaml, "round_trip.yaml"), std::move(components));
  }
  double metric(const std::string& name) const {
    double sum = 0;
    for (const auto& sample : metrics.collect()) {
      if (sample.name == name) sum += sample.value;
    }
    return sum;
  }
  /// What instance `id` got back, as numbers; fails for what another one sent.
  static std::vector<int> numbers(const std::string& id) {
    const auto texts = Answers::get().of(id);
    EXPECT_THAT(texts, Each(StartsWith(id + " ")));
    std::vector<int> found;
    found.reserve(texts.size());
    for (const auto& text : texts) found.push_back(std::stoi(text.substr(id.size())));
    return found;
  }
  static std::vector<int> up_to(int count) {
    std::vector<int> all(static_cast<std::size_t>(count));
    for (int i = 0; i < count; ++i) all[static_cast<std::size_t>(i)] = i;
    return all;
  }

  config::Metrics metrics;
  local::LocalOptions options;
};

TEST_F(LocalMode, SendsEachDriversMessagesBackToThatDriverInOrder) {
  local::LocalCluster cluster(options);
  run(cluster);
  const auto first = cluster.deploy("pinger", {{"count", "200"}});
  const auto second = cluster.deploy("pinger", {{"count", "200"}});
  ASSERT_TRUE(Answers::get().wait_for(first, 200));
  ASSERT_TRUE(Answers::get().wait_for(second, 200));
  EXPECT_EQ(numbers(first), up_to(200));
  EXPECT_EQ(numbers(second), up_to(200));
  EXPECT_TRUE(cluster.stop(std::chrono::seconds(60)));
}

TEST_F(LocalMode, DoesSoOnSharedChannelsToo) {
  options.gateways = {"gateway-1"_gateway, "gateway-2"_gateway};
  local::LocalCluster cluster(options);
  run(cluster);
  std::vector<std::string> ids;
  for (const auto& gateway : {"gateway-1"_gateway, "gateway-1"_gateway, "gateway-2"_gateway}) {
    ids.push_back(cluster.deploy("pinger", {{"count", "100"}, {"shared", "true"}}, gateway));
  }
  for (const auto& id : ids) {
    ASSERT_TRUE(Answers::get().wait_for(id, 100));
    EXPECT_EQ(numbers(id), up_to(100));
  }
}

TEST_F(LocalMode, ADriverReadsThePropertiesThatABoltSets) {
  local::LocalCluster cluster(options);
  run(cluster, R"(
topology.name: judging
spouts:
  ping: {broker: rabbitmq, driver: judged, channel: ping, fields: [ping, driverID, time]}
bolts:
  judge:
    class: test.Judge
    inputs: {from: ping}
  pong:
    broker: rabbitmq
    driver: judged
    channel: pong
    fields: [pong, driverID, time, {property: judged, as: verdict}]
    inputs: {from: judge}
)");
  const auto id = cluster.deploy("judged", {{"count", "6"}});
  ASSERT_TRUE(Answers::get().wait_for(id, 6));
  EXPECT_THAT(Answers::get().of(id), ElementsAre(id + " 0", id + " 1 is odd", id + " 2 is even", id + " 3",
                                                 id + " 4 is even", id + " 5 is odd"));
}

TEST_F(LocalMode, FindsADriverThatWasThereBeforeTheTopology) {
  local::LocalCluster cluster(options);
  const auto id = cluster.deploy("pinger", {{"count", "50"}});
  run(cluster);
  ASSERT_TRUE(Answers::get().wait_for(id, 50));
  EXPECT_EQ(numbers(id), up_to(50));
}

TEST_F(LocalMode, LetsOneDriverGoWhileAnotherIsServed) {
  local::LocalCluster cluster(options);
  run(cluster);
  const auto leaving = cluster.deploy("pinger");
  const auto staying = cluster.deploy("pinger");
  ASSERT_TRUE(Answers::get().wait_for(leaving, 20));
  cluster.undeploy(leaving);
  const auto before = Answers::get().of(staying).size();
  ASSERT_TRUE(Answers::get().wait_for(staying, before + 100));
  const auto back = cluster.deploy("pinger");
  ASSERT_TRUE(Answers::get().wait_for(back, 20));
}

TEST_F(LocalMode, TriesAMessageAgainWhenABoltThrows) {
  throws_left = 2;
  local::LocalCluster cluster(options);
  run(cluster);
  const auto id = cluster.deploy("pinger", {{"count", "50"}});
  ASSERT_TRUE(Answers::get().wait_for(id, 50));
  auto got = numbers(id);
  std::sort(got.begin(), got.end());
  EXPECT_EQ(got, up_to(50));
  EXPECT_EQ(metric("iotcloud_spout_retried_total"), 2);
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 0);
}

TEST_F(LocalMode, GivesAMessageUpAfterItsLastTryAndGoesOn) {
  throws_left = 3;  // maxTries is 3, and one message at a time is under way
  local::LocalCluster cluster(options);
  run(cluster);
  const auto id = cluster.deploy("pinger", {{"count", "1"}});
  EXPECT_TRUE(tests::eventually([&] { return metric("iotcloud_spout_rejected_total") >= 1; }));
  EXPECT_EQ(metric("iotcloud_spout_rejected_total"), 1);
  EXPECT_THAT(Answers::get().of(id), IsEmpty());
  const auto next = cluster.deploy("pinger", {{"count", "10"}});
  EXPECT_TRUE(Answers::get().wait_for(next, 10));
}

TEST_F(LocalMode, StopsWhileMessagesFlowAndLeavesNoTraceOfTheTopology) {
  local::LocalCluster cluster(options);
  run(cluster);
  const auto id = cluster.deploy("pinger");
  ASSERT_TRUE(Answers::get().wait_for(id, 20));
  EXPECT_THAT(discovery::list_topologies(cluster.registry(), cluster.paths()), SizeIs(1));
  EXPECT_TRUE(cluster.stop(std::chrono::seconds(60)));
  EXPECT_THAT(discovery::list_topologies(cluster.registry(), cluster.paths()), IsEmpty());
}

TEST_F(LocalMode, SharesTheDriversBetweenTwoWorkersAndMovesThemWhenOneStops) {
  local::LocalCluster cluster(options);
  auto& first = run(cluster);
  auto& second = run(cluster);
  std::vector<std::string> ids;
  ids.reserve(4);
  for (int i = 0; i < 4; ++i) ids.push_back(cluster.deploy("pinger"));
  for (const auto& id : ids) ASSERT_TRUE(Answers::get().wait_for(id, 20));
  const auto received = [](const topology::Worker& worker) { return worker.snapshot().component("ping").emitted; };
  // The first one reads all of them until it hears of the second.
  ASSERT_TRUE(eventually([&] { return received(first) > 0 && received(second) > 0; }));

  first.stop(std::chrono::seconds(5));
  for (const auto& id : ids) {
    const auto before = Answers::get().of(id).size();
    EXPECT_TRUE(Answers::get().wait_for(id, before + 20)) << "nobody reads " << id;
  }
}

TEST_F(LocalMode, MeetsNoFleetBelowARootOfItsOwnAndLeavesNothingThere) {
  local::LocalCluster fleet(options);
  const auto of_fleet = fleet.deploy("pinger");
  auto own = options;
  own.registry_url = "embedded://" + options.name;
  own.own_root = "/own";
  own.name += "-own";
  {
    local::LocalCluster cluster(own);  // its gateway has the id of the fleet's
    run(cluster);
    const auto id = cluster.deploy("pinger");
    ASSERT_TRUE(Answers::get().wait_for(id, 20));
    EXPECT_TRUE(fleet.registry().get("/own"));
    EXPECT_THAT(fleet.master().drivers(), SizeIs(1));
    EXPECT_TRUE(cluster.stop(std::chrono::seconds(60)));
    EXPECT_THAT(cluster.master().drivers(), IsEmpty());
    EXPECT_THAT(cluster.master().orders(), IsEmpty());
  }
  EXPECT_FALSE(fleet.registry().get("/own"));
  EXPECT_THAT(fleet.master().orders(), SizeIs(1));
  EXPECT_THAT(discovery::list_gateways(fleet.registry(), fleet.paths()), SizeIs(1));
}

TEST_F(LocalMode, RefusesADriverThatIsNotThere) {
  local::LocalCluster cluster(options);
  EXPECT_THROW(cluster.deploy("no_such_driver"), config::Error);
}

}  // namespace
}  // namespace iotcloud::tests
