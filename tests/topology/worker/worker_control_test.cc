#include <atomic>
#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/discovery/passing_registry.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/security/signer.h>
#include <iotcloud/tests/topology/workshop.h>
#include <iotcloud/topology/worker/control.h>

namespace iotcloud::topology::workshop {
namespace {

using discovery::TopologyOrder;
using testing::Contains;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

/// A registry that answers all questions at once, but in which what is to be held comes to stand only after answer():
/// as when it denies a process its node, or is overloaded.
class LateRegistry final : public tests::PassingRegistry {
 public:
  using PassingRegistry::PassingRegistry;

  discovery::GuardPtr hold_eventually(const std::string& path, const std::string& data, bool sequential,
                                      std::function<void(const std::string&)> on_created) override {
    auto guard = std::make_unique<Late>();
    answer_ = [this, held = guard->held, path, data, sequential, on_created = std::move(on_created)] {
      *held = PassingRegistry::hold_eventually(path, data, sequential, on_created);
    };
    return guard;
  }
  void answer() { std::exchange(answer_, nullptr)(); }

 private:
  struct Late final : discovery::Guard {
    const std::shared_ptr<discovery::GuardPtr> held = std::make_shared<discovery::GuardPtr>();
  };
  std::function<void()> answer_;
};

/// in -> work (2 tasks) -> what the test says, and its place in an embedded registry.
class WorkerControlTest : public testing::Test {
 protected:
  WorkerControlTest() {
    static std::atomic<int> counter{0};
    name_ = "control-test-" + std::to_string(getpid()) + "-" + std::to_string(++counter);
    server_ = discovery::embedded::RegistryServer::named(name_);
    registry_ = connect(500ms);
    EXPECT_TRUE(eventually([this] { return server_->sessions().size() == 1; }));  // the worker's is the first
    watcher_ = connect(tests::patience);
  }

  std::unique_ptr<discovery::Registry> connect(std::chrono::milliseconds operation_timeout) const {
    discovery::RegistryOptions options;
    options.url = "embedded://" + name_;
    options.session_timeout = 500ms;
    options.operation_timeout = operation_timeout;
    return discovery::make_registry(options);
  }

  /// Starts the runtime as the worker does, and its control.
  void start(std::chrono::milliseconds patience = 20s) {
    TopologyBuilder builder;
    builder.set_spout("in", source_spout(source_));
    builder
        .set_bolt("work", bolt([this](const Tuple& tuple, OutputCollector& collector, const TopologyContext&) {
                    const std::lock_guard lock(mutex_);
                    collector_ = &collector;
                    if (keep_) return kept_.push_back(tuple);
                    collector.ack(tuple);
                  }),
                  2)
        .shuffle_grouping("in");
    RuntimeOptions options;
    options.threads = 1;
    options.metrics = &metrics_;
    runtime_ = std::make_unique<Runtime>(builder.build("t"), options);
    runtime_->deactivate();
    runtime_->start();
    auto services = std::make_shared<EndpointServices>();
    services->topology = "t"_topology;
    services->worker = "w1";
    services->registry = registry_.get();
    services->clock = &config::system_clock();
    services->metrics = &metrics_;
    WorkerControl::Options control;
    control.services = services;
    control.runtime = runtime_.get();
    control.topology.name = "t"_topology;
    control.worker.name = "w1";
    control.worker.http = "127.0.0.1:1";
    control.worker.since_ms = config::system_clock().wall_ms();
    control.masters = masters_;
    control.patience = patience;
    control.on_joined = on_joined_;
    control.on_killed = [this] {
      ++killed_;
      control_->leave();
    };
    control_ = std::make_unique<WorkerControl>(std::move(control));
    control_->start();
  }
  /// Ends the control as the worker does, whose on_killed uses the control too.
  void end_control() {
    if (!control_) return;
    control_->end();
    control_.reset();
  }
  void TearDown() override {
    end_control();
    {
      const std::lock_guard lock(mutex_);
      kept_.clear();  // a tuple does not outlive its runtime
    }
    runtime_.reset();
  }

  void order(const TopologyOrder& order) {
    discovery::put(*watcher_, paths_.topology_order("t"_topology), discovery::encode(order));
  }
  static TopologyOrder numbered(std::int64_t revision, bool active = true) {
    TopologyOrder order;
    order.revision = revision;
    order.active = active;
    return order;
  }
  TopologyOrder kill_of(std::vector<std::string> workers, std::int64_t drain_ms = 20'000) const {
    TopologyOrder order = numbered(5);
    order.kill = {std::move(workers), drain_ms, config::system_clock().wall_ms() + 60'000};
    return order;
  }
  /// What the worker says of itself in the registry.
  discovery::WorkerRecord told() {
    const auto workers = discovery::list_workers(*watcher_, paths_, "t"_topology);
    return workers.empty() ? discovery::WorkerRecord{} : workers.front();
  }
  /// Sends a tuple that stays unacked. \return whether it came.
  bool keep_one() {
    {
      const std::lock_guard lock(mutex_);
      keep_ = true;
    }
    source_->put(Values(1));
    return eventually([&] {
      const std::lock_guard lock(mutex_);
      return kept_.size() == 1;
    });
  }
  bool says(const std::string& state, std::int64_t revision) {
    return eventually([&] {
      const auto record = told();
      return record.state == state && record.revision == revision;
    });
  }
  std::optional<std::string> end_report() {
    const auto node = watcher_->get(paths_.ended_workers("t"_topology) + "/w1");
    return node ? std::optional(node->data) : std::nullopt;
  }

  std::string name_;
  const discovery::Paths paths_;
  config::Metrics metrics_;
  tests::HandClock registrys_{config::Clock::Instant(1h),
                              config::system_clock().wall_ms() - std::chrono::milliseconds(24h).count()};
  std::shared_ptr<discovery::embedded::RegistryServer> server_;
  std::unique_ptr<discovery::Registry> registry_, watcher_;
  std::shared_ptr<const security::TrustedKeys> masters_;
  std::shared_ptr<Source> source_ = std::make_shared<Source>();
  std::mutex mutex_;
  bool keep_ = false;                     ///< guarded by mutex_: tuples are not acked
  std::vector<Tuple> kept_;               ///< guarded by mutex_
  OutputCollector* collector_ = nullptr;  ///< guarded by mutex_: of the task that ran last
  std::atomic<int> killed_{0};
  std::atomic<int> joined_{0}, recorded_{0};  ///< how often it joined, and had a record then
  std::function<void()> on_joined_;           ///< empty: nobody counts that
  std::unique_ptr<Runtime> runtime_;
  std::unique_ptr<WorkerControl> control_;
};

TEST_F(WorkerControlTest, ShowsTheWorkerAndLetsTheSpoutsGoWhenNothingIsOrdered) {
  start();
  ASSERT_TRUE(says("active", 0));
  const auto record = told();
  EXPECT_EQ(record.http, "127.0.0.1:1");
  EXPECT_EQ(record.components.at("work"), (discovery::WorkerRecord::Component{2, 2}));
  EXPECT_TRUE(eventually([&] { return runtime_->snapshot().active; }));
  EXPECT_TRUE(eventually([&] { return discovery::list_topologies(*watcher_, paths_).size() == 1; }));
}

TEST_F(WorkerControlTest, StartsInactiveWhenThatIsOrderedAndGoesOnAtTheNextOrder) {
  order(numbered(3, false));
  source_->lay(Values(1));
  start();
  ASSERT_TRUE(says("inactive", 3));
  EXPECT_EQ(source_->waiting(), 1U);
  EXPECT_THAT(source_->calls(), Not(Contains("activate")));
  order(numbered(4));
  ASSERT_TRUE(says("active", 4));
  EXPECT_TRUE(eventually([&] { return source_->acked().size() == 1; }));
}

TEST_F(WorkerControlTest, ChangesTheParallelism) {
  start();
  auto wanted = numbered(1);
  wanted.parallelism = {{"work", 1}};
  order(wanted);
  ASSERT_TRUE(says("active", 1));
  EXPECT_EQ(runtime_->snapshot().parallelism.at("work"), 1);
  EXPECT_EQ(told().components.at("work").parallelism, 1);
  order(numbered(2));
  ASSERT_TRUE(says("active", 2));
  EXPECT_EQ(runtime_->snapshot().parallelism.at("work"), 2) << "no order changes what was declared";
}

TEST_F(WorkerControlTest, StaysAsItIsWhenTheRegistryWasEmptiedOrPutBack) {
  start();
  auto wanted = numbered(3, false);
  wanted.parallelism = {{"work", 1}};
  order(wanted);
  ASSERT_TRUE(says("inactive", 3));
  const auto tells = [&](const std::string& text) {
    return eventually([&] { return told().error.find(text) != std::string::npos; });
  };
  watcher_->remove(paths_.topology_order("t"_topology));
  EXPECT_TRUE(tells("the registry was emptied: there is no order; this worker stays inactive, as order 3 said"));
  order(numbered(2));
  EXPECT_TRUE(tells("the registry was put back to order 2"));
  EXPECT_EQ(told().state, "inactive");
  EXPECT_FALSE(runtime_->snapshot().active);
  EXPECT_EQ(runtime_->snapshot().parallelism.at("work"), 1);
  order(numbered(4));
  ASSERT_TRUE(says("active", 4));
  EXPECT_EQ(told().error, "");
}

TEST_F(WorkerControlTest, ReportsWhatItCannotDoAndDoesTheRest) {
  start();
  auto wanted = numbered(1, false);
  wanted.parallelism = {{"work", 3}, {"wrok", 1}};
  order(wanted);
  ASSERT_TRUE(says("inactive", 1));
  EXPECT_THAT(told().error, HasSubstr("work"));
  EXPECT_THAT(told().error, HasSubstr("\"wrok\""));
  EXPECT_FALSE(runtime_->snapshot().active);
}

TEST_F(WorkerControlTest, ReportsAnOrderThatCannotBeReadAndKeepsTheState) {
  start();
  order(numbered(1, false));
  ASSERT_TRUE(says("inactive", 1));
  discovery::put(*watcher_, paths_.topology_order("t"_topology), "{");
  EXPECT_TRUE(eventually([&] { return told().error.find("JSON") != std::string::npos; }));
  EXPECT_EQ(told().state, "inactive");
}

TEST_F(WorkerControlTest, RunsAsDeclaredWhenTheRegistryIsSilentAndObeysWhenItSpeaks) {
  order(numbered(2, false));
  server_->stop();
  start(20ms);
  ASSERT_TRUE(eventually([&] { return runtime_->snapshot().active; }));
  server_->start();
  ASSERT_TRUE(says("inactive", 2));
}

TEST_F(WorkerControlTest, HasJoinedOnlyOnceARegistryThatAnswersLateHasItsRecord) {
  ASSERT_TRUE(eventually([&] { return server_->sessions().size() == 2; })) << "so that the worker's is the last one";
  auto late = std::make_unique<LateRegistry>(connect(500ms));
  LateRegistry& registry = *late;
  registry_ = std::move(late);
  on_joined_ = [this] {
    if (watcher_->get(paths_.workers("t"_topology) + "/w1")) ++recorded_;
    ++joined_;
  };
  start();
  ASSERT_TRUE(eventually([&] { return runtime_->snapshot().active; }));
  EXPECT_EQ(joined_, 0) << "it works, but nobody finds it";
  registry.answer();
  ASSERT_TRUE(says("active", 0));
  EXPECT_TRUE(eventually([&] { return joined_ == 1; }));
  server_->expire(server_->sessions().back());
  EXPECT_TRUE(eventually([&] { return joined_ == 2; })) << "its record went with its session, and is there again";
  EXPECT_EQ(recorded_, 2);
}

TEST_F(WorkerControlTest, IsShownWithItsStateAgainAfterItsSessionExpired) {
  start();
  order(numbered(1, false));
  ASSERT_TRUE(says("inactive", 1));
  server_->expire(server_->sessions().front());
  ASSERT_TRUE(says("inactive", 1));
}

TEST_F(WorkerControlTest, DrainsLeavesAReportAndTheRegistryWhenKilled) {
  start();
  ASSERT_TRUE(says("active", 0));
  ASSERT_TRUE(keep_one());
  order(kill_of({"w1"}));
  ASSERT_TRUE(says("draining", 5));
  EXPECT_EQ(killed_, 0);
  EXPECT_TRUE(eventually([&] { return !runtime_->snapshot().active; })) << "which it does after it has said so";
  {
    const std::lock_guard lock(mutex_);
    collector_->ack(kept_.front());
    kept_.clear();
  }
  ASSERT_TRUE(eventually([&] { return killed_ == 1; }));
  EXPECT_EQ(end_report(), "");
  EXPECT_EQ(source_->acked().size(), 1U);
  EXPECT_TRUE(eventually([&] { return discovery::list_workers(*watcher_, paths_, "t"_topology).empty(); }));
}

TEST_F(WorkerControlTest, ReportsADrainThatDidNotEndInTime) {
  start();
  ASSERT_TRUE(says("active", 0));
  ASSERT_TRUE(keep_one());
  order(kill_of({"w1"}, 1));
  ASSERT_TRUE(eventually([&] { return killed_ == 1; }));
  EXPECT_THAT(end_report().value_or(""), HasSubstr("it was not done after 1 ms; tuples under way: 1 of in"));
  EXPECT_TRUE(eventually([&] { return discovery::list_workers(*watcher_, paths_, "t"_topology).empty(); }));
  EXPECT_TRUE(watcher_->get(paths_.topology_order("t"_topology))) << "the master that waits clears it away";
}

TEST_F(WorkerControlTest, TheLastOneClearsAKillAwayThatNobodyWaitsFor) {
  start();
  ASSERT_TRUE(says("active", 0));
  auto kill = kill_of({"w1"});
  kill.kill->awaited_until_ms = 1;
  order(kill);
  ASSERT_TRUE(eventually([&] { return killed_ == 1; }));
  EXPECT_TRUE(eventually([&] { return !watcher_->get(paths_.topology("t"_topology)); }));
}

TEST_F(WorkerControlTest, ShowsNoTopologyOnceItIsKilledThoughTheOrderComesWhenItJoins) {
  auto kill = kill_of({"w1"});
  kill.kill->awaited_until_ms = 1;
  order(kill);
  start();
  ASSERT_TRUE(eventually([&] { return killed_ == 1; }));
  end_control();
  EXPECT_FALSE(watcher_->get(paths_.topology("t"_topology)));
}

TEST_F(WorkerControlTest, IsNotKilledByAnOrderForThoseBeforeItAndClearsThatAway) {
  auto kill = kill_of({"w0"});
  kill.active = false;
  kill.kill->awaited_until_ms = 1;
  order(kill);
  discovery::put(*watcher_, paths_.ended_workers("t"_topology) + "/w0", "");
  start();
  ASSERT_TRUE(says("active", 0));
  EXPECT_TRUE(eventually([&] { return !watcher_->get(paths_.topology_order("t"_topology)); }));
  EXPECT_EQ(killed_, 0);
  EXPECT_TRUE(runtime_->snapshot().active);
}

TEST_F(WorkerControlTest, WhatIsOrderedOutlivesTheLastWorkerThatStops) {
  start();
  order(numbered(1, false));
  ASSERT_TRUE(says("inactive", 1));
  end_control();
  EXPECT_THAT(discovery::list_workers(*watcher_, paths_, "t"_topology), IsEmpty());
  EXPECT_TRUE(watcher_->get(paths_.topology_order("t"_topology)));
  watcher_->remove(paths_.topology_order("t"_topology));
  start();
  ASSERT_TRUE(says("active", 0));
  end_control();
  EXPECT_FALSE(watcher_->get(paths_.topology("t"_topology))) << "nothing was ordered: nothing stays";
}

/// A worker that knows its masters' keys, and somebody else who can write to the registry.
class SignedTopologyOrders : public WorkerControlTest {
 protected:
  SignedTopologyOrders() {
    security::TrustedKeys::Options trust;
    trust.require_signature = true;
    trust.trusted_keys = {master_.public_file()};
    masters_ = std::make_shared<security::TrustedKeys>(trust);
  }
  std::string place() const { return paths_.topology_order("t"_topology); }
  void write(const std::string& bytes) { discovery::put(*watcher_, place(), bytes); }
  std::string signed_by(const security::test::Signer& key, const TopologyOrder& order) const {
    return security::sign_object(key.key(), place(), encode(order));
  }
  /// An order that is given now, so many milliseconds later than that.
  static TopologyOrder given(std::int64_t revision, bool active, std::int64_t later_ms = 0) {
    TopologyOrder order = numbered(revision, active);
    order.given_ms = config::system_clock().wall_ms() + later_ms;
    return order;
  }
  double refusals() {
    return static_cast<double>(metrics_.counter("iotcloud_topology_orders_refused_total", "").value());
  }
  bool refuses(double count, const std::string& why) {
    return eventually([&] { return refusals() >= count && told().error.find(why) != std::string::npos; });
  }

  const tests::TemporaryFolder folder_;
  const security::test::Signer master_{folder_ / "", "master"};
  const security::test::Signer thief_{folder_ / "", "thief"};
};

TEST_F(SignedTopologyOrders, OfATrustedMasterAreFollowedAndOthersAreRefusedSaidAndCounted) {
  start();
  ASSERT_TRUE(says("active", 0));
  auto kill = given(1, true);
  kill.kill = {{"w1"}, 20'000, config::system_clock().wall_ms() + 60'000};
  const std::string good = signed_by(master_, given(1, false));
  std::string tampered = good;
  tampered.replace(tampered.find("\"revision\":1"), 12, "\"revision\":2");
  double count = 0;
  for (const auto& forged :
       {encode(given(1, false)), encode(kill), signed_by(thief_, given(1, false)), tampered,
        security::sign_object(master_.key(), paths_.topology_order("u"_topology), encode(given(1, false)))}) {
    write(forged);
    EXPECT_TRUE(refuses(++count, "no trusted master has signed it for this topology; this worker stays active"))
        << forged;
  }
  EXPECT_TRUE(runtime_->snapshot().active);
  EXPECT_EQ(killed_, 0);
  write(good);
  EXPECT_TRUE(says("inactive", 1));
  EXPECT_EQ(told().error, "");
  EXPECT_EQ(refusals(), count);
}

TEST_F(SignedTopologyOrders, AreFollowedSoonAfterTheirMastersKeyHasComeAndNoneOfItSoonAfterItIsGone) {
  const std::filesystem::path keys = folder_ / "keys";
  std::filesystem::create_directory(keys);
  std::filesystem::copy_file(master_.public_file(), keys / "master.pub");
  masters_ = std::make_shared<const security::TrustedKeys>(security::TrustedKeys::Options{true, {keys}});
  start();
  const security::test::Signer second(folder_ / "", "second");
  write(signed_by(second, given(1, false)));
  ASSERT_TRUE(refuses(1, "no trusted master has signed it"));
  std::filesystem::copy_file(second.public_file(), keys / "second.pub");
  ASSERT_TRUE(says("inactive", 1));
  EXPECT_EQ(told().error, "");

  const auto trusted = masters_->generation();
  std::filesystem::remove(keys / "second.pub");
  ASSERT_TRUE(eventually([&] { return masters_->generation() != trusted; }));
  write(signed_by(second, given(2, true)));
  EXPECT_TRUE(refuses(2, "no trusted master has signed it"));
  EXPECT_FALSE(runtime_->snapshot().active);
}

TEST_F(SignedTopologyOrders, ThatWereGivenBeforeTheLastOneAreOutOfDate) {
  start();
  ASSERT_TRUE(says("active", 0));
  const auto long_ago = -std::chrono::milliseconds(24h).count();
  write(signed_by(master_, given(9, false, long_ago)));  // of an earlier run of this topology
  EXPECT_TRUE(refuses(1, "out of date"));
  EXPECT_TRUE(runtime_->snapshot().active);
  const auto last = given(1, true);
  write(signed_by(master_, last));
  ASSERT_TRUE(says("active", 1));
  auto earlier = given(9, false);
  earlier.given_ms = last.given_ms - 1;
  write(signed_by(master_, earlier));
  EXPECT_TRUE(refuses(2, "out of date"));
  EXPECT_TRUE(runtime_->snapshot().active);
  watcher_->remove(place());
  EXPECT_TRUE(eventually([&] { return told().error.find("there is no order") != std::string::npos; }));
  write(signed_by(master_, given(2, false)));
  EXPECT_TRUE(says("inactive", 2));
}

TEST_F(SignedTopologyOrders, FromBeforeAWorkersStartAreFollowedWhenItStarts) {
  server_->keep_time_by(registrys_);
  write(signed_by(master_, given(3, false, -std::chrono::milliseconds(24h).count())));
  registrys_.advance(24h);
  start();
  EXPECT_TRUE(says("inactive", 3));
  EXPECT_EQ(refusals(), 0);
}

TEST_F(SignedTopologyOrders, ThatWereWrittenOnceMoreBeforeAWorkersStartAreOutOfDate) {
  write(signed_by(master_, given(3, false, -std::chrono::milliseconds(24h).count())));
  start();
  EXPECT_TRUE(refuses(1, "long before it was written here"));
  EXPECT_TRUE(says("active", 0)) << "as its file says";
  write(signed_by(master_, given(4, false)));
  EXPECT_TRUE(says("inactive", 4));
  EXPECT_EQ(told().error, "");
}

TEST_F(SignedTopologyOrders, AreFollowedInARegistryWhoseClockIsWrong) {
  server_->keep_time_by(registrys_);
  registrys_.set_wall_ms(config::system_clock().wall_ms() + std::chrono::milliseconds(240h).count());
  write(signed_by(master_, given(3, false)));
  start();
  EXPECT_TRUE(says("inactive", 3));
  EXPECT_EQ(refusals(), 0);
}

}  // namespace
}  // namespace iotcloud::topology::workshop
