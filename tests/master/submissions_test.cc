// Topologies that are submitted to pools, which the test plays.
#include <functional>
#include <mutex>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/presence.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/master/orders/submission_orders.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/master/fleet.h>

namespace iotcloud::master {
namespace {

using discovery::Submission;
using test::eventually;
using test::TestMaster;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

/// A pool that has all places of topology "t", and does what the test says.
class FakePool {
 public:
  /// The state of a place, and why, for the version that it is to run.
  using Behaviour = std::function<std::pair<std::string, std::string>(int place, std::int64_t version)>;
  static Behaviour obey() {
    return [](int, std::int64_t) { return std::pair<std::string, std::string>("running", ""); };
  }
  static Behaviour fail_at(int place, std::int64_t version) {
    return [=](int at, std::int64_t wanted) {
      return at == place && wanted == version ? std::pair<std::string, std::string>("failed", "there is no class")
                                              : std::pair<std::string, std::string>("running", "");
    };
  }

  FakePool(const std::string& url, const std::string& id, Behaviour behaviour = obey())
      : behaviour_(std::move(behaviour)), registry_(test::open_registry(url)) {
    record_.id = discovery::PoolId(id);
    record_.host = "h";
    node_ = registry_->hold(paths_.pool(record_.id), encode(record_));
    submitted_ = registry_->watch_node(paths_.submission("t"_topology), [this](const auto& node) {
      if (node) follow(discovery::decode_submission(node->data, "t"));
    });
  }
  ~FakePool() { submitted_.reset(); }

  void behave(Behaviour behaviour) {
    const std::lock_guard lock(mutex_);
    behaviour_ = std::move(behaviour);
  }
  /// The versions that its places were to run, as "0:1 1:1", each time that they changed.
  std::vector<std::string> seen() const {
    const std::lock_guard lock(mutex_);
    return seen_;
  }
  /// The last of them that its record tells.
  std::string told() const {
    const std::lock_guard lock(mutex_);
    return told_;
  }

 private:
  void follow(const Submission& submission) {
    std::string versions;
    {
      const std::lock_guard lock(mutex_);
      record_.places.clear();
      held_.clear();
      for (int place = 0; !submission.killed && place < submission.workers; ++place) {
        const auto version = submission.version_of(place).number;
        const auto [state, reason] = behaviour_(place, version);
        versions += (versions.empty() ? "" : " ") + std::to_string(place) + ":" + std::to_string(version);
        record_.places.push_back({"t"_topology, place, {}, version, state, reason, "w", 1});
        held_.push_back(
            registry_->hold(paths_.place("t"_topology, place), encode(discovery::PlaceHolder{record_.id, ""})));
      }
      if (submission.killed) versions = "killed";
      if (seen_.empty() || seen_.back() != versions) seen_.push_back(versions);
    }
    registry_->set(paths_.pool(record_.id), encode(record_));
    const std::lock_guard lock(mutex_);
    told_ = versions;
  }

  const discovery::Paths paths_;
  mutable std::mutex mutex_;
  Behaviour behaviour_;            ///< guarded by mutex_
  std::vector<std::string> seen_;  ///< guarded by mutex_
  std::string told_;               ///< guarded by mutex_
  std::unique_ptr<discovery::Registry> registry_;
  discovery::PoolRecord record_;
  std::vector<discovery::GuardPtr> held_;
  discovery::GuardPtr node_;
  discovery::GuardPtr submitted_;
};

class Submissions : public testing::Test {
 protected:
  Submissions() { EXPECT_TRUE(master_.leads()); }

  OrderResult give(const std::string& kind, const std::string& fields) {
    return master_->give(kind, R"({"topology": "t", "wait_ms": 60000)" + fields + "}").result;
  }
  OrderResult submit(int workers = 2, const std::string& yaml = "one") {
    return give("submitTopology", R"(, "yaml": ")" + yaml + R"(", "workers": )" + std::to_string(workers));
  }
  OrderResult update(const std::string& yaml, const std::string& more = "") {
    return give("updateTopology", R"(, "yaml": ")" + yaml + "\"" + more);
  }
  Submission standing() {
    const auto all = discovery::list_submissions(master_.registry(), discovery::Paths());
    return all.contains("t"_topology) ? all.at("t"_topology).submission : Submission{};
  }
  TopologyResult kill() {
    TopologyRequest request;
    request.topology = "t"_topology;
    request.change = TopologyChange::kill;
    request.wait = test::patience;
    return master_->order(request);
  }

  const std::string url_ = test::fresh_registry_url();
  TestMaster master_{url_};
};

TEST_F(Submissions, AnswerWhenAllWorkersRun) {
  FakePool pool(url_, "p1");
  const auto result = submit();
  EXPECT_TRUE(result.all_done()) << result.summary();
  ASSERT_THAT(result.outcomes, SizeIs(2));
  EXPECT_EQ(result.outcomes[1].instance, "t/1");
  EXPECT_EQ(result.outcomes[1].gateway, "p1");
  const auto topologies = master_->topologies();
  ASSERT_THAT(topologies, SizeIs(1));
  EXPECT_EQ(topologies[0].wanted_workers, 2);
  EXPECT_EQ(topologies[0].version, 1);
  EXPECT_THAT(topologies[0].places, SizeIs(2));
}

TEST_F(Submissions, AreRefusedWithoutAPoolOrUnderANameThatIsTaken) {
  EXPECT_THAT(submit().text, HasSubstr("no pool of workers runs"));
  FakePool pool(url_, "p1");
  EXPECT_TRUE(submit().all_done());
  EXPECT_THAT(submit().text, HasSubstr("submitted already"));
  EXPECT_EQ(standing().version.number, 1);
}

TEST_F(Submissions, AreRefusedUnderTheNameOfWorkersThatWereStartedByHand) {
  FakePool pool(url_, "p1");
  discovery::WorkerRecord worker;
  worker.name = "by-hand";
  const auto held = master_.registry().hold(discovery::Paths().workers("t"_topology) + "/by-hand", encode(worker));
  EXPECT_THAT(submit().text, AllOf(HasSubstr("runs already"), HasSubstr("by-hand")));
}

TEST_F(Submissions, AreRefusedUnderTheNameOfATopologyThatStormRuns) {
  FakePool pool(url_, "p1");
  discovery::ReaderRecord reader;
  reader.topology = "t"_topology;
  reader.engine = discovery::engine_storm;
  auto held =
      master_.registry().hold(discovery::Paths().readers("t", "d"_driver, "up") + "/members/slot-1", encode(reader));
  EXPECT_THAT(submit().text, AllOf(HasSubstr("Apache Storm runs a topology t already"), HasSubstr("worker slot-1"),
                                   HasSubstr("topology kill t --engine storm")));
  EXPECT_EQ(standing().version.number, 0);
  held.reset();
  EXPECT_TRUE(submit().all_done());
}

TEST_F(Submissions, AreTakenBackWhenAWorkerCannotRun) {
  FakePool pool(url_, "p1", FakePool::fail_at(1, 1));
  const auto result = submit();
  ASSERT_THAT(result.outcomes, SizeIs(2));
  EXPECT_EQ(result.outcomes[1].outcome, OrderOutcome::failed);
  EXPECT_THAT(result.outcomes[1].reason, AllOf(HasSubstr("there is no class"), HasSubstr("taken back")));
  EXPECT_THAT(master_->topologies(), IsEmpty());
  pool.behave(FakePool::obey());
  EXPECT_TRUE(submit().all_done());
  EXPECT_EQ(standing().version.number, 2);
}

TEST_F(Submissions, SayWhichPlaceNoPoolHasTaken) {
  FakePool pool(url_, "p1",
                [](int, std::int64_t) { return std::pair<std::string, std::string>("starting", "slowly"); });
  const auto result = master_->give("submitTopology", R"({"topology": "t", "yaml": "y", "wait_ms": 50})").result;
  ASSERT_THAT(result.outcomes, SizeIs(1));
  EXPECT_EQ(result.outcomes[0].outcome, OrderOutcome::unknown);
  EXPECT_FALSE(standing().killed);  // it may run yet
}

TEST_F(Submissions, AreUpdatedPlaceByPlace) {
  FakePool pool(url_, "p1");
  EXPECT_TRUE(submit(3).all_done());
  const auto result = update("two");
  EXPECT_TRUE(result.all_done()) << result.summary();
  EXPECT_THAT(pool.seen(), ElementsAre("0:1 1:1 2:1", "0:2 1:1 2:1", "0:2 1:2 2:1", "0:2 1:2 2:2"));
  EXPECT_EQ(standing().previous->yaml, "one");
}

TEST_F(Submissions, GoBackWhenAWorkerOfTheNextVersionDoesNotRun) {
  FakePool pool(url_, "p1", FakePool::fail_at(1, 2));
  EXPECT_TRUE(submit(3).all_done());
  const auto result = update("two");
  ASSERT_THAT(result.outcomes, SizeIs(2));
  for (const auto& outcome : result.outcomes) {
    EXPECT_EQ(outcome.outcome, OrderOutcome::failed);
    EXPECT_THAT(outcome.reason, HasSubstr("back on version 1"));
  }
  EXPECT_EQ(pool.seen().back(), "0:1 1:1 2:1");
  EXPECT_EQ(standing().version.yaml, "one");
  EXPECT_TRUE(update("three").all_done());
  EXPECT_EQ(standing().version.number, 3);
}

TEST_F(Submissions, AreLeftAloneByAnUpdateToWhatTheyRunButForTheNumberOfWorkers) {
  FakePool pool(url_, "p1");
  EXPECT_TRUE(submit(2).all_done());
  EXPECT_TRUE(update("one", R"(, "workers": 3)").all_done());
  EXPECT_EQ(pool.seen().back(), "0:1 1:1 2:1");
  EXPECT_EQ(standing().previous, std::nullopt);
}

TEST_F(Submissions, AnUpdateThatStoppedInTheMiddleGoesOn) {
  FakePool pool(url_, "p1");
  EXPECT_TRUE(submit(3).all_done());
  EXPECT_TRUE(update("two").all_done());
  auto stopped = standing();
  stopped.pending = 2;
  discovery::put(master_.registry(), discovery::Paths().submission("t"_topology), encode(stopped));
  EXPECT_TRUE(eventually([&] { return pool.told() == "0:2 1:1 2:1"; }));
  EXPECT_TRUE(update("two").all_done());
  EXPECT_EQ(pool.seen().back(), "0:2 1:2 2:2");
}

TEST_F(Submissions, AreRolledBackToTheVersionBefore) {
  FakePool pool(url_, "p1");
  EXPECT_TRUE(submit(2).all_done());
  EXPECT_THAT(give("rollbackTopology", "").text, HasSubstr("has had no other version"));
  EXPECT_TRUE(update("two").all_done());
  EXPECT_TRUE(give("rollbackTopology", "").all_done());
  EXPECT_EQ(standing().version.yaml, "one");
  EXPECT_EQ(pool.seen().back(), "0:1 1:1");
}

TEST_F(Submissions, AreEndedByAKillAndTheirNameIsFree) {
  FakePool pool(url_, "p1");
  EXPECT_TRUE(submit(2).all_done());
  const auto result = kill();
  EXPECT_EQ(result.refusal, OrderRefusal::none) << result.text;
  EXPECT_EQ(pool.seen().back(), "killed");
  EXPECT_THAT(master_->topologies(), IsEmpty());
  EXPECT_TRUE(standing().killed);
  EXPECT_THAT(standing().version.yaml, IsEmpty());
  EXPECT_EQ(kill().refusal, OrderRefusal::unknown_topology) << "the mark that stays is no topology";
  EXPECT_THAT(update("two").text, HasSubstr("is not submitted"));
  EXPECT_TRUE(submit(1, "again").all_done());
  EXPECT_EQ(standing().version.number, 2);
}

TEST_F(Submissions, HaveAHistoryThatOutlivesThem) {
  FakePool pool(url_, "p1", FakePool::fail_at(0, 2));
  EXPECT_TRUE(submit(1).all_done());
  EXPECT_FALSE(update("two").all_done());
  kill();
  const auto events = master_->history("t"_topology).events;
  ASSERT_THAT(events, SizeIs(3));
  EXPECT_EQ(events[0].order, "submit");
  EXPECT_EQ(events[0].version, 1);
  EXPECT_THAT(events[1].outcome, HasSubstr("there is no class"));
  EXPECT_EQ(events[2].order, "kill");
}

TEST_F(Submissions, AreRefusedWhenTheyCannotBeWhatTheySay) {
  FakePool pool(url_, "p1");
  EXPECT_THAT(submit(1001).text, HasSubstr("1 to 1000 workers"));
  EXPECT_THAT(submit(1, "").text, HasSubstr("empty"));
  EXPECT_THAT(
      give("submitTopology", R"(, "yaml": "y", "libraries": [{"name": "a", "file": "../a", "sha256": "x"}])").text,
      HasSubstr("../a"));
  EXPECT_THAT(master_->give("submitTopology", R"({"topology": "a/b", "yaml": "y"})").result.text, HasSubstr("a/b"));
}

}  // namespace
}  // namespace iotcloud::master
