#include <functional>
#include <future>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::TopologyOrder;
using discovery::WorkerRecord;
using test::eventually;
using test::TestMaster;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

/// A worker of the topology "t" that hears orders, and does what the test says.
class FakeWorker {
 public:
  /// Changes its record as the order asks; nullopt: it says nothing; for a kill, the end report.
  using Behaviour = std::function<std::optional<std::string>(const TopologyOrder&, WorkerRecord&)>;
  static std::optional<std::string> obey(const TopologyOrder& order, WorkerRecord& record) {
    record.state = order.active ? "active" : "inactive";
    record.revision = order.revision;
    return "";
  }
  static Behaviour say_nothing() {
    return [](const TopologyOrder&, WorkerRecord&) { return std::nullopt; };
  }

  FakeWorker(const std::string& url, const std::string& name, Behaviour behaviour = obey)
      : behaviour_(std::move(behaviour)), registry_(test::open_registry(url)) {
    record_.name = name;
    record_.host = "h";
    record_.state = "active";
    record_.components = {{"in", {1, 1}}, {"work", {2, 4}}};
    discovery::TopologyRecord topology;
    topology.name = "t"_topology;
    discovery::put(*registry_, paths_.topology("t"_topology), encode(topology));
    node_ = registry_->hold(path(), encode(record_));
    orders_ = registry_->watch_node(paths_.topology_order("t"_topology), [this](const auto& node) {
      if (node) follow(discovery::decode_topology_order(node->data, "order"));
    });
  }
  ~FakeWorker() { orders_.reset(); }

 private:
  std::string path() const { return paths_.workers("t"_topology) + "/" + record_.name; }
  void follow(const TopologyOrder& order) {
    const auto answer = behaviour_(order, record_);
    if (!answer) return;
    if (!order.kill) return registry_->set(path(), encode(record_));
    if (!node_) return;
    if (*answer != "crash")
      discovery::put(*registry_, paths_.ended_workers("t"_topology) + "/" + record_.name, *answer);
    node_.reset();
  }

  const discovery::Paths paths_;
  const Behaviour behaviour_;
  std::unique_ptr<discovery::Registry> registry_;
  WorkerRecord record_;
  discovery::GuardPtr node_;
  discovery::GuardPtr orders_;
};

class TopologyOrders : public testing::Test {
 protected:
  TopologyOrders() { EXPECT_TRUE(master.leads()); }
  TopologyResult give(TopologyChange change, std::map<std::string, int> parallelism = {},
                      std::chrono::milliseconds wait = test::patience) {
    TopologyRequest request;
    request.topology = "t"_topology;
    request.change = change;
    request.parallelism = std::move(parallelism);
    request.wait = wait;
    return master->order(request);
  }
  std::optional<TopologyOrder> standing() {
    const auto node = master.registry().get(paths.topology_order("t"_topology));
    return node ? std::optional(discovery::decode_topology_order(node->data, "order")) : std::nullopt;
  }
  const std::string url = test::fresh_registry_url();
  const discovery::Paths paths;
  TestMaster master{url};
};

TEST_F(TopologyOrders, AnswerWhenAllWorkersHaveFollowed) {
  FakeWorker one(url, "w1"), two(url, "w2");
  const auto result = give(TopologyChange::deactivate);
  EXPECT_TRUE(result.all_done()) << result.summary();
  ASSERT_THAT(result.outcomes, SizeIs(2));
  EXPECT_EQ(result.outcomes[0].worker, "w1");
  EXPECT_EQ(result.outcomes[0].host, "h");
  ASSERT_TRUE(standing());
  EXPECT_FALSE(standing()->active);
  EXPECT_EQ(standing()->epoch, master->status().epoch);
  EXPECT_TRUE(give(TopologyChange::activate).all_done());
  EXPECT_TRUE(standing()->active);
  EXPECT_EQ(standing()->revision, 2);
}

TEST_F(TopologyOrders, KeepWhatWasOrderedBefore) {
  FakeWorker one(url, "w1");
  EXPECT_TRUE(give(TopologyChange::deactivate).all_done());
  EXPECT_TRUE(give(TopologyChange::rebalance, {{"work", 4}}).all_done());
  EXPECT_TRUE(give(TopologyChange::rebalance, {{"in", 1}}).all_done());
  EXPECT_FALSE(standing()->active);
  EXPECT_EQ(standing()->parallelism, (std::map<std::string, int>{{"in", 1}, {"work", 4}}));
}

TEST_F(TopologyOrders, TellWhichWorkerFailedAndWhichIsSilent) {
  FakeWorker good(url, "w1");
  FakeWorker bad(url, "w2", [](const TopologyOrder& order, WorkerRecord& record) {
    record.error = "cannot";
    return FakeWorker::obey(order, record);
  });
  FakeWorker silent(url, "w3", FakeWorker::say_nothing());
  std::chrono::milliseconds limit(500);
  const auto result =
      test::with_time_for_all_but(1, limit, [&](auto wait) { return give(TopologyChange::deactivate, {}, wait); });
  EXPECT_FALSE(result.all_done());
  ASSERT_THAT(result.outcomes, SizeIs(3));
  EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::done);
  EXPECT_EQ(result.outcomes[1].outcome, OrderOutcome::failed);
  EXPECT_EQ(result.outcomes[1].reason, "cannot");
  EXPECT_EQ(result.outcomes[2].outcome, OrderOutcome::unknown);
  EXPECT_THAT(result.outcomes[2].reason,
              AllOf(HasSubstr(fmt::format("not known after {} s", static_cast<double>(limit.count()) / 1000)),
                    HasSubstr("last state: active, order 0")));
}

TEST_F(TopologyOrders, AreRefusedWithWhatIsPossible) {
  EXPECT_EQ(give(TopologyChange::activate).refusal, OrderRefusal::unknown_topology);
  FakeWorker one(url, "w1");
  const auto wrong = [&](std::map<std::string, int> parallelism) {
    const auto result = give(TopologyChange::rebalance, std::move(parallelism));
    EXPECT_EQ(result.refusal, OrderRefusal::bad_request);
    return result.text;
  };
  EXPECT_THAT(wrong({{"wrok", 1}}), AllOf(HasSubstr("\"wrok\""), HasSubstr("in (1 to 1), work (1 to 4)")));
  EXPECT_THAT(wrong({{"work", 5}}), HasSubstr("1 to 4"));
  EXPECT_THAT(wrong({{"work", 0}}), HasSubstr("1 to 4"));
  EXPECT_THAT(wrong({}), HasSubstr("COMPONENT=N"));
  TopologyRequest other;
  other.topology = "../iot"_topology;
  EXPECT_THAT(master->order(other).text, HasSubstr("there are t"));
  EXPECT_FALSE(standing()) << "a refusal writes nothing";
}

TEST_F(TopologyOrders, AreRecordedForWorkersThatStartLater) {
  { FakeWorker gone(url, "w0"); }
  ASSERT_TRUE(eventually([&] { return discovery::list_workers(master.registry(), paths, "t"_topology).empty(); }));
  const auto result = give(TopologyChange::deactivate);
  EXPECT_TRUE(result.all_done());
  EXPECT_THAT(result.text, HasSubstr("those that start will follow"));
  EXPECT_FALSE(standing()->active);
  EXPECT_THAT(give(TopologyChange::rebalance, {{"work", 1}}).text, HasSubstr("start one first"));
}

TEST_F(TopologyOrders, AKillIsDoneWhenAllWorkersDrainedAndLeavesNothing) {
  FakeWorker one(url, "w1"), two(url, "w2");
  EXPECT_TRUE(give(TopologyChange::deactivate).all_done());
  const auto result = give(TopologyChange::kill);
  EXPECT_TRUE(result.all_done()) << result.summary();
  EXPECT_THAT(result.outcomes, SizeIs(2));
  EXPECT_FALSE(master.registry().get(paths.topology("t"_topology)));
}

TEST_F(TopologyOrders, AKillTellsWhoDidNotDrainAndWhoCrashed) {
  FakeWorker slow(url, "w1", [](const TopologyOrder&, WorkerRecord&) { return "3 tuples were under way"; });
  FakeWorker crash(url, "w2", [](const TopologyOrder&, WorkerRecord&) { return "crash"; });
  const auto result = give(TopologyChange::kill);
  ASSERT_THAT(result.outcomes, SizeIs(2));
  EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::failed);
  EXPECT_THAT(result.outcomes[0].reason, HasSubstr("3 tuples were under way"));
  EXPECT_EQ(result.outcomes[1].outcome, OrderOutcome::failed);
  EXPECT_THAT(result.outcomes[1].reason, HasSubstr("crashed"));
  EXPECT_FALSE(master.registry().get(paths.topology("t"_topology)));
}

TEST_F(TopologyOrders, WhileAKillIsUnderWayNothingElseIsTaken) {
  FakeWorker silent(url, "w1", FakeWorker::say_nothing());
  const auto result = give(TopologyChange::kill, {}, std::chrono::milliseconds(50));
  EXPECT_EQ(result.outcomes.at(0).outcome, OrderOutcome::unknown);
  ASSERT_TRUE(standing()) << "the order stands";
  EXPECT_THAT(standing()->kill->workers, ElementsAre("w1"));
  EXPECT_THAT(give(TopologyChange::activate).text, HasSubstr("is being killed"));
}

TEST_F(TopologyOrders, AnOldKillIsForgottenByTheNextOrder) {
  TopologyOrder old;
  old.revision = 7;
  old.active = false;
  old.kill = {{"w0"}, 0, 0};
  discovery::put(master.registry(), paths.topology_order("t"_topology), encode(old));
  FakeWorker fresh(url, "w1", [](const TopologyOrder& order, WorkerRecord& record) -> std::optional<std::string> {
    if (order.kill) return std::nullopt;  // not for this one
    return FakeWorker::obey(order, record);
  });
  EXPECT_TRUE(give(TopologyChange::rebalance, {{"work", 1}}).all_done());
  EXPECT_FALSE(standing()->kill);
  EXPECT_TRUE(standing()->active);
  EXPECT_EQ(standing()->revision, 8);
}

TEST_F(TopologyOrders, AKillWithoutWorkersForgetsWhatWasOrdered) {
  { FakeWorker gone(url, "w0"); }
  ASSERT_TRUE(eventually([&] { return discovery::list_workers(master.registry(), paths, "t"_topology).empty(); }));
  EXPECT_TRUE(give(TopologyChange::deactivate).all_done());
  EXPECT_TRUE(give(TopologyChange::kill).all_done());
  EXPECT_THAT(master->topologies(), IsEmpty());
}

TEST_F(TopologyOrders, AnEarlierMasterDoesNotOverwriteALaterOnesOrder) {
  FakeWorker one(url, "w1");
  TopologyOrder later;
  later.revision = 1;
  later.epoch = master->status().epoch + 1;
  discovery::put(master.registry(), paths.topology_order("t"_topology), encode(later));
  const auto result = give(TopologyChange::deactivate);
  EXPECT_THAT(result.text, HasSubstr("a later master"));
  EXPECT_TRUE(standing()->active);
}

TEST_F(TopologyOrders, AreRefusedByAMasterOnStandby) {
  FakeWorker one(url, "w1");
  TestMaster second(url);
  ASSERT_TRUE(eventually([&] { return !second->status().registry_away; }));
  TopologyRequest request;
  request.topology = "t"_topology;
  EXPECT_EQ(second->order(request).refusal, OrderRefusal::not_leading);
}

}  // namespace
}  // namespace iotcloud::master
