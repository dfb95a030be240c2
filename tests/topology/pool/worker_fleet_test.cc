#include <deque>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/topology/pool/fake_launcher.h>
#include <iotcloud/tests/topology/pool/views.h>
#include <iotcloud/topology/pool/worker_fleet.h>

namespace iotcloud::topology {
namespace {

using namespace std::chrono_literals;
using How = WorkerEnding::How;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

class WorkerFleetTest : public testing::Test {
 protected:
  static WorkerOrder order(int place, std::int64_t version) {
    return {{discovery::TopologyName("t"), place}, views::submission("t", 1, version).version};
  }
  /// Runs what workers have posted.
  void settle() {
    while (!tasks_.empty()) {
      const auto task = std::move(tasks_.front());
      tasks_.pop_front();
      task();
    }
  }
  discovery::PlaceStatus state(std::size_t index = 0) const { return fleet_.states().at(index); }
  std::shared_ptr<FakeLauncher::Worker> worker() const { return launcher_.workers().at(0); }
  void crash() {
    worker()->end(How::failed, "crashed");
    settle();
  }

  FakeLauncher launcher_;
  tests::HandClock clock_;
  std::deque<std::function<void()>> tasks_;
  int changes_ = 0;
  WorkerFleet fleet_{launcher_,
                     {.restart = {.first = 500ms, .longest = 2s, .healthy_after = 60s, .give_up_after = 4},
                      .stop_limit = 10s,
                      .clock = &clock_,
                      .post = [this](std::function<void()> task) { tasks_.push_back(std::move(task)); },
                      .on_change = [this] { ++changes_; }}};
};

TEST_F(WorkerFleetTest, StartsAWorkerForAPlaceAndTellsWhenItRuns) {
  fleet_.run(order(0, 1));
  EXPECT_THAT(launcher_.running_versions(), ElementsAre("t/0 v1"));
  EXPECT_EQ(state().state, "starting");
  worker()->run();
  settle();
  EXPECT_EQ(state().state, "running");
  EXPECT_EQ(state().worker, "w");
  EXPECT_EQ(state().version, 1);
  const int changes = changes_;
  worker()->run();  // as the answer to a ping
  settle();
  EXPECT_EQ(changes_, changes);
}

TEST_F(WorkerFleetTest, ReplacesAWorkerByAnotherVersionWhenItHasEnded) {
  fleet_.run(order(0, 1));
  worker()->run();
  settle();
  fleet_.run(order(0, 2));
  EXPECT_TRUE(worker()->told_to_stop);
  EXPECT_EQ(state().state, "stopping");
  EXPECT_EQ(state().version, 1);
  worker()->end(How::stopped);
  settle();
  EXPECT_THAT(launcher_.running_versions(), ElementsAre("t/0 v2"));
  EXPECT_EQ(state().version, 2);
}

TEST_F(WorkerFleetTest, StartsACrashedWorkerAgainAfterAPauseThatDoubles) {
  fleet_.run(order(0, 1));
  for (const auto pause : {500ms, 1000ms, 2000ms}) {
    crash();
    EXPECT_THAT(state().reason, HasSubstr("it crashed; it is started again in"));
    EXPECT_EQ(fleet_.do_due(), clock_.now() + pause);
    clock_.advance(pause - 1ms);
    fleet_.do_due();
    EXPECT_THAT(launcher_.workers(), IsEmpty());
    clock_.advance(1ms);
    EXPECT_EQ(fleet_.do_due(), std::nullopt);
    EXPECT_THAT(launcher_.workers(), SizeIs(1));
  }
  worker()->run();
  settle();
  EXPECT_EQ(state().state, "running");
  EXPECT_EQ(state().reason, "again, after it crashed");
}

TEST_F(WorkerFleetTest, LeavesAWorkerAloneThatFailsAgainAndAgainUntilItGetsAnotherVersion) {
  fleet_.run(order(0, 1));
  for (int failure = 1; failure < 4; ++failure) {
    crash();
    clock_.advance(2s);
    fleet_.do_due();
  }
  crash();
  EXPECT_EQ(state().state, "failed");
  EXPECT_THAT(state().reason, HasSubstr("that was failure 4 in a row"));
  EXPECT_EQ(fleet_.do_due(), std::nullopt);
  fleet_.run(order(0, 1));
  EXPECT_THAT(launcher_.workers(), IsEmpty());
  fleet_.run(order(0, 2));
  EXPECT_THAT(launcher_.running_versions(), ElementsAre("t/0 v2"));
}

TEST_F(WorkerFleetTest, DoesNotStartAgainWhatCannotRun) {
  fleet_.run(order(0, 1));
  worker()->end(How::refused, "there is no class \"X\"");
  settle();
  EXPECT_EQ(state().state, "failed");
  EXPECT_EQ(state().reason, "there is no class \"X\"");
  launcher_.refuse("the library is not signed");
  fleet_.run(order(1, 1));
  EXPECT_EQ(state(1).state, "failed");
  EXPECT_EQ(state(1).reason, "the library is not signed");
  EXPECT_EQ(fleet_.do_due(), std::nullopt);
}

TEST_F(WorkerFleetTest, TriesAgainWhenSomethingLacksForNow) {
  launcher_.run_short("no memory");
  fleet_.run(order(0, 1));
  EXPECT_EQ(state().state, "starting");
  EXPECT_THAT(state().reason, HasSubstr("could not be started: no memory; it is started again in 500 ms"));
  launcher_.run_short("");
  clock_.advance(500ms);
  fleet_.do_due();
  EXPECT_THAT(launcher_.running_versions(), ElementsAre("t/0 v1"));
}

TEST_F(WorkerFleetTest, TellsTheBeginningOfWhatAWorkerSaysAtLength) {
  fleet_.run(order(0, 1));
  worker()->end(How::refused, std::string(1'000'000, 'x'));
  settle();
  EXPECT_EQ(state().reason, std::string(400, 'x') + "...");
}

TEST_F(WorkerFleetTest, AWorkerThatStopsAlreadyMayGetLessTime) {
  fleet_.run(order(0, 1));
  fleet_.run(order(0, 2));
  EXPECT_EQ(worker()->stop_limit, 10s);
  fleet_.end(order(0, 1).place, 1s);
  EXPECT_EQ(worker()->stop_limit, 1s);
}

TEST_F(WorkerFleetTest, EndsAWorkerAndForgetsItsPlace) {
  fleet_.run(order(0, 1));
  worker()->run();
  settle();
  fleet_.end(order(0, 1).place);
  EXPECT_TRUE(worker()->told_to_stop);
  EXPECT_TRUE(fleet_.has(order(0, 1).place));
  worker()->end(How::stopped);
  settle();
  EXPECT_FALSE(fleet_.has(order(0, 1).place));
  EXPECT_THAT(launcher_.workers(), IsEmpty());
}

TEST_F(WorkerFleetTest, LetsAWorkerEndByItselfAndStopsItOnlyWhenThatTakesTooLong) {
  fleet_.run(order(0, 1));
  worker()->run();
  settle();
  fleet_.let_end(order(0, 1).place, 7s);
  fleet_.let_end(order(0, 1).place, 7s);
  EXPECT_EQ(fleet_.do_due(), clock_.now() + 7s);
  EXPECT_FALSE(worker()->told_to_stop);
  clock_.advance(7s);
  fleet_.do_due();
  EXPECT_TRUE(worker()->told_to_stop);
  worker()->end(How::failed, "exited with status 0");
  settle();
  EXPECT_THAT(fleet_.states(), IsEmpty());
}

TEST_F(WorkerFleetTest, EndsAtOnceWhatDoesNotRunYet) {
  fleet_.run(order(0, 1));
  fleet_.let_end(order(0, 1).place, 7s);
  EXPECT_TRUE(worker()->told_to_stop);
  worker()->end(How::stopped);
  settle();
  fleet_.run(order(0, 1));
  crash();
  fleet_.let_end(order(0, 1).place, 7s);
  EXPECT_THAT(fleet_.states(), IsEmpty());
  EXPECT_EQ(fleet_.do_due(), std::nullopt);
}

TEST_F(WorkerFleetTest, HeedsNoWorkerThatItHasReplaced) {
  fleet_.run(order(0, 1));
  const auto before = worker();
  crash();
  clock_.advance(500ms);
  fleet_.do_due();
  before->run();
  before->end(How::failed, "late");
  settle();
  EXPECT_EQ(state().state, "starting");
  EXPECT_THAT(launcher_.workers(), SizeIs(1));
}

TEST_F(WorkerFleetTest, AdoptsWorkersOfAnEarlierRunAndKeepsThoseOfTheWantedVersion) {
  launcher_.left_running = {{"x", {discovery::TopologyName("t"), 0}, 1}, {"y", {discovery::TopologyName("t"), 1}, 1}};
  EXPECT_THAT(fleet_.adopt(), SizeIs(2));
  fleet_.run(order(0, 1));
  fleet_.run(order(1, 2));
  for (const auto& one : launcher_.workers()) EXPECT_EQ(one->told_to_stop, one->place.number == 1);
}

TEST_F(WorkerFleetTest, CannotStartAgainWhatNobodyOrders) {
  launcher_.left_running = {{"x", {discovery::TopologyName("t"), 0}, 1}};
  fleet_.adopt();
  crash();
  EXPECT_EQ(state().state, "failed");
  EXPECT_THAT(state().reason, HasSubstr("does not know what is to run"));
}

}  // namespace
}  // namespace iotcloud::topology
