// Pools in a registry, with workers that the test plays.
#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/security/sha256.h>
#include <iotcloud/security/signed_object.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/security/certificates.h>
#include <iotcloud/tests/security/signer.h>
#include <iotcloud/tests/topology/pool/fake_launcher.h>
#include <iotcloud/tests/topology/pool/views.h>
#include <iotcloud/topology/pool/pool.h>

namespace iotcloud::topology {
namespace {

using namespace std::chrono_literals;
using discovery::Submission;
using discovery::TopologyName;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using tests::eventually;

/// A pool, and its own session at the registry.
struct TestPool {
  TestPool(const std::string& url, const std::string& folder, const std::string& id,
           std::shared_ptr<const security::TrustedKeys> masters = {}, const std::string& state_id = "")
      : launcher(std::make_shared<FakeLauncher>()) {
    discovery::RegistryOptions options;
    options.url = url;
    options.session_timeout = tests::patience;  // else one that is cut off would soon have a new one by itself
    options.operation_timeout = 400ms;
    registry = discovery::make_registry(options);
    EXPECT_TRUE(eventually([this] { return registry->session() == discovery::SessionState::connected; }));
    PoolOptions wanted;
    wanted.record = views::pool(id);
    wanted.record.state_id = state_id.empty() ? id : state_id;
    wanted.registry = registry.get();
    wanted.launcher = launcher;
    processes::PluginStore::Options store;
    store.folder = folder + "/" + id;
    libraries = wanted.libraries = std::make_shared<processes::PluginStore>(store);
    wanted.masters = std::move(masters);
    wanted.session_timeout = 400ms;
    wanted.stop_limit = 1s;
    pool = std::make_unique<Pool>(std::move(wanted));
    launcher->obey();
  }
  std::vector<std::string> running() const { return launcher->running_versions(); }
  /// Sends it a library. \return it, as the topology's "x.so"
  discovery::SentLibrary send(const std::string& bytes) const {
    const auto upload =
        libraries->offer({"x.so", security::sha256_hex(bytes), static_cast<std::int64_t>(bytes.size()), ""});
    libraries->add(upload, 0, bytes);
    libraries->finish(upload);
    pool->take_library();
    return {"x.so", "x.so", security::sha256_hex(bytes)};
  }

  std::unique_ptr<discovery::Registry> registry;
  std::shared_ptr<FakeLauncher> launcher;
  std::shared_ptr<processes::PluginStore> libraries;
  std::unique_ptr<Pool> pool;
};

class PoolTest : public testing::Test {
 protected:
  PoolTest() {
    static std::atomic<int> counter{0};
    name_ = "pool-test-" + std::to_string(getpid()) + "-" + std::to_string(++counter);
    server_ = discovery::embedded::RegistryServer::named(name_);
    discovery::RegistryOptions options;
    options.url = "embedded://" + name_;
    watcher_ = discovery::make_registry(options);
    folder_ = std::filesystem::temp_directory_path() / name_;
    std::filesystem::create_directories(folder_);
  }
  ~PoolTest() override { std::filesystem::remove_all(folder_); }

  std::unique_ptr<TestPool> make(const std::string& id, std::shared_ptr<const security::TrustedKeys> masters = {},
                                 const std::string& state_id = "") const {
    return std::make_unique<TestPool>("embedded://" + name_, folder_, id, std::move(masters), state_id);
  }
  std::unique_ptr<TestPool> start(const std::string& id) const {
    auto pool = make(id);
    pool->pool->start();
    return pool;
  }
  void submit(const Submission& submission) {
    discovery::put(*watcher_, paths_.submission(submission.name), discovery::encode(submission));
  }
  discovery::PoolRecord record(const std::string& id) {
    for (auto& pool : discovery::list_pools(*watcher_, paths_)) {
      if (pool.id == discovery::PoolId(id)) return pool;
    }
    return {};
  }
  std::size_t holders() { return discovery::list_holders(*watcher_, paths_, {TopologyName("t")}).size(); }

  const discovery::Paths paths_;
  std::string name_, folder_;
  std::shared_ptr<discovery::embedded::RegistryServer> server_;
  std::unique_ptr<discovery::Registry> watcher_;
};

TEST_F(PoolTest, PoolsShareTheWorkersOfATopologyAndTellWhatTheyDo) {
  const auto one = start("p1"), two = start("p2");
  submit(views::submission("t", 4));
  EXPECT_TRUE(eventually([&] { return one->running().size() == 2 && two->running().size() == 2; }));
  EXPECT_TRUE(eventually([&] {
    const auto places = record("p1").places;
    return places.size() == 2 && places[0].state == "running" && places[0].worker == "w";
  }));
  EXPECT_TRUE(eventually([&] { return holders() == 4; }));
}

TEST_F(PoolTest, APoolThatComesGetsItsShare) {
  const auto one = start("p1");
  submit(views::submission("t", 4));
  EXPECT_TRUE(eventually([&] { return one->running().size() == 4; }));
  const auto two = start("p2");
  EXPECT_TRUE(eventually([&] { return one->running().size() == 2 && two->running().size() == 2; }));
}

TEST_F(PoolTest, WhatALostPoolRanIsTakenOver) {
  const auto one = start("p1"), two = start("p2");
  submit(views::submission("t", 4));
  EXPECT_TRUE(eventually([&] { return one->running().size() == 2 && two->running().size() == 2; }));
  const int before = two->launcher->started();
  const auto session = watcher_->get(paths_.pool(discovery::PoolId("p1")))->owner_session;
  server_->partition(session);
  server_->expire(session);
  EXPECT_TRUE(eventually([&] { return two->launcher->started() == before + 2; }));
  // One that comes back ends what others run meanwhile, and gets its share again.
  server_->restore(session);
  EXPECT_TRUE(eventually([&] { return one->running().size() == 2 && two->running().size() == 2; }));
  EXPECT_TRUE(eventually([&] { return holders() == 4; }));
}

TEST_F(PoolTest, APoolThatStopsGivesItsPlacesUp) {
  auto one = start("p1");
  const auto two = start("p2");
  submit(views::submission("t", 2));
  EXPECT_TRUE(eventually([&] { return one->running().size() == 1 && two->running().size() == 1; }));
  one->pool->stop(5s);
  EXPECT_THAT(one->running(), IsEmpty());
  EXPECT_TRUE(eventually([&] { return two->running().size() == 2; }));
}

TEST_F(PoolTest, EachPlaceRunsTheVersionThatItIsToRun) {
  const auto one = start("p1");
  submit(views::submission("t", 2));
  EXPECT_TRUE(eventually([&] { return one->running().size() == 2; }));
  auto updated = views::submission("t", 2, 2);
  updated.previous = views::submission("t", 2).version;
  updated.pending = 1;
  submit(updated);
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v2", "t/1 v1"}; }));
  updated.pending = 0;
  submit(updated);
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v2", "t/1 v2"}; }));
}

TEST_F(PoolTest, AVersionBeforeTheLastOneIsStartedAsOneThatIsGoneBackTo) {
  const auto one = start("p1");
  submit(views::submission("t", 1, 2));
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v2"}; }));
  auto back = views::submission("t", 1, 1);
  back.last_number = 2;
  submit(back);
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v1 again"}; }));
}

TEST_F(PoolTest, ATopologyWithFewerWorkersGivesPlacesUp) {
  const auto one = start("p1");
  submit(views::submission("t", 3));
  EXPECT_TRUE(eventually([&] { return one->running().size() == 3; }));
  submit(views::submission("t", 1));
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v1"} && holders() == 1; }));
}

TEST_F(PoolTest, WorkersOfAKilledTopologyEndByThemselvesAndAreNotStartedAgain) {
  const auto one = start("p1");
  submit(views::submission("t", 2));
  EXPECT_TRUE(eventually([&] { return record("p1").places.size() == 2 && record("p1").places[1].state == "running"; }));
  auto killed = views::submission("t", 2);
  killed.killed = true;
  killed.drain_ms = 60'000;
  submit(killed);
  EXPECT_TRUE(
      eventually([&] { return record("p1").places.size() == 2 && record("p1").places[1].state == "stopping"; }));
  for (const auto& worker : one->launcher->workers()) {
    EXPECT_FALSE(worker->told_to_stop);
    worker->end(WorkerEnding::How::failed, "exited with status 0");
  }
  EXPECT_TRUE(eventually([&] { return holders() == 0 && record("p1").places.empty(); }));
  EXPECT_EQ(one->launcher->started(), 2);
}

TEST_F(PoolTest, ASubmissionThatVanishesEndsNothing) {
  const auto one = start("p1");
  submit(views::submission("t", 1));
  EXPECT_TRUE(eventually([&] { return one->running().size() == 1; }));
  watcher_->remove(paths_.submission(TopologyName("t")));
  submit(views::submission("another", 1));
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"another/0 v1", "t/0 v1"}; }));
}

TEST_F(PoolTest, APoolAdoptsTheWorkersOfItsEarlierRun) {
  submit(views::submission("t", 2));
  discovery::RegistryOptions options;
  options.url = "embedded://" + name_;
  const auto before = discovery::make_registry(options);
  const auto held = before->hold(paths_.place(TopologyName("t"), 0),
                                 discovery::encode(discovery::PlaceHolder{discovery::PoolId("p1"), "p1"}));
  const auto record_before = before->hold(paths_.pool(discovery::PoolId("p1")), discovery::encode([] {
                                            auto pool = views::pool("p1");
                                            pool.state_id = "p1";
                                            return pool;
                                          }()));
  const auto one = make("p1");
  one->launcher->left_running = {{"x", {TopologyName("t"), 0}, 1}};
  one->pool->start();
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v1", "t/1 v1"}; }));
  EXPECT_EQ(one->launcher->started(), 2);  // the adopted one counts
}

TEST_F(PoolTest, AWorkerWhoseLibraryCameAfterThePoolGoesOnWhenTheSessionIsLost) {
  const auto one = start("p1");
  auto submission = views::submission("t", 1);
  submission.version.libraries = {one->send("a library")};
  submit(submission);
  ASSERT_TRUE(eventually([&] { return one->running().size() == 1 && holders() == 1; }));
  const auto path = paths_.pool(discovery::PoolId("p1"));
  ASSERT_TRUE(eventually([&] { return record("p1").files.size() == 1; }));
  for (int lost = 0; lost < 20; ++lost) {  // the record that comes back is the first one, for a moment
    const auto session = watcher_->get(path)->owner_session;
    server_->expire(session);
    ASSERT_TRUE(eventually([&] {
      const auto node = watcher_->get(path);
      return node && node->owner_session != session && record("p1").files.size() == 1 && holders() == 1;
    }));
    ASSERT_EQ(one->launcher->started(), 1);
  }
}

TEST_F(PoolTest, AWorkerGoesOnWhenNoPoolCanRunItsNextVersion) {
  const auto one = start("p1");
  submit(views::submission("t", 1));
  ASSERT_TRUE(eventually([&] { return one->running().size() == 1; }));
  auto next = views::submission("t", 1, 2);
  next.version.libraries = {{"x.so", "x.so", security::sha256_hex("a library")}};
  submit(next);
  submit(views::submission("u", 1));  // it is followed after the other
  ASSERT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v1", "u/0 v1"}; }));
  one->send("a library");
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v2", "u/0 v1"}; }));
}

TEST_F(PoolTest, ASecondPoolOfTheSameIdIsRefused) {
  const auto one = start("p1");
  ASSERT_TRUE(eventually([&] { return record("p1").state_id == "p1"; }));
  const auto other = make("p1", {}, "another folder");
  try {
    other->pool->start();
    FAIL() << "it started";
  } catch (const config::Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("another pool with the id p1 lives"));
  }
}

TEST_F(PoolTest, AWorkerThatCannotBeStartedIsToldWithItsReason) {
  const auto one = start("p1");
  one->launcher->refuse("there is no such library");
  submit(views::submission("t", 1));
  EXPECT_TRUE(eventually([&] {
    const auto places = record("p1").places;
    return places.size() == 1 && places[0].state == "failed" && places[0].reason == "there is no such library";
  }));
}

/// Submissions with a master's signature.
class SignedPoolTest : public PoolTest {
 protected:
  SignedPoolTest() {
    security::TrustedKeys::Options trust;
    trust.require_signature = true;
    trust.trusted_keys = {signer_.public_file()};
    masters_ = std::make_shared<security::TrustedKeys>(trust);
  }
  std::string signed_by(const security::test::Signer& signer, const Submission& submission) const {
    return security::sign_object(signer.key(), paths_.submission(submission.name), discovery::encode(submission));
  }
  void put(const std::string& bytes) { discovery::put(*watcher_, paths_.submission(TopologyName("t")), bytes); }
  static Submission given(std::int64_t version, std::int64_t ago_ms) {
    auto submission = views::submission("t", 1, version);
    submission.given_ms = config::system_clock().wall_ms() - ago_ms;
    return submission;
  }

  const security::test::Signer signer_{folder_ + "/", "master"}, stranger_{folder_ + "/", "stranger"};
  std::shared_ptr<security::TrustedKeys> masters_;
};

TEST_F(SignedPoolTest, FollowsOnlyWhatATrustedMasterHasSignedLast) {
  const auto one = make("p1", masters_);
  one->pool->start();
  put(signed_by(stranger_, given(1, 0)));
  EXPECT_TRUE(
      eventually([&] { return record("p1").trouble.find("no trusted master has signed it") != std::string::npos; }));
  EXPECT_THAT(one->pool->trouble(), HasSubstr("the submission of topology t is refused"));
  EXPECT_THAT(one->running(), IsEmpty());
  const auto first = signed_by(signer_, given(1, 20'000));
  put(first);
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v1"}; }));
  put(signed_by(signer_, given(2, 10'000)));
  EXPECT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v2"}; }));
  put(first);
  EXPECT_TRUE(eventually([&] { return record("p1").trouble.find("out of date") != std::string::npos; }));
  EXPECT_THAT(one->running(), ElementsAre("t/0 v2"));
}

TEST_F(SignedPoolTest, FollowsASubmissionSoonAfterItsMastersKeyHasComeAndNoneOfItSoonAfterItIsGone) {
  const std::filesystem::path keys = std::filesystem::path(folder_) / "keys";
  std::filesystem::create_directory(keys);
  std::filesystem::copy_file(signer_.public_file(), keys / "master.pub");
  masters_ = std::make_shared<security::TrustedKeys>(security::TrustedKeys::Options{true, {keys}});
  const auto one = make("p1", masters_);
  one->pool->start();
  const auto is_refused = [&] {
    return record("p1").trouble.find("no trusted master has signed it") != std::string::npos;
  };
  put(signed_by(stranger_, given(1, 0)));
  ASSERT_TRUE(eventually(is_refused));
  std::filesystem::copy_file(stranger_.public_file(), keys / "second.pub");
  ASSERT_TRUE(eventually([&] { return one->running() == std::vector<std::string>{"t/0 v1"}; }));
  EXPECT_TRUE(eventually([&] { return record("p1").trouble.empty(); })) << record("p1").trouble;

  const auto trusted = masters_->generation();
  std::filesystem::remove(keys / "second.pub");
  ASSERT_TRUE(eventually([&] { return masters_->generation() != trusted; }));
  put(signed_by(stranger_, given(2, 0)));
  ASSERT_TRUE(eventually(is_refused));
  EXPECT_THAT(one->running(), ElementsAre("t/0 v1"));
}

TEST_F(SignedPoolTest, RefusesAnOldSubmissionThatSomebodyWritesOnceMore) {
  const auto one = make("p1", masters_);
  one->pool->start();
  put(signed_by(signer_, given(1, 3'600'000)));
  EXPECT_TRUE(eventually([&] { return record("p1").trouble.find("long before it was written") != std::string::npos; }));
  EXPECT_THAT(one->running(), IsEmpty());
}

}  // namespace
}  // namespace iotcloud::topology
