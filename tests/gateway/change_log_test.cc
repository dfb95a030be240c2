#include <algorithm>
#include <filesystem>
#include <fstream>
#include <future>
#include <optional>
#include <thread>

#include <gmock/gmock.h>
#include <stdlib.h>
#include <unistd.h>

#include <iotcloud/gateway/change_log.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>
#include <iotcloud/tests/sync_calls.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<DriverState> states(const std::vector<StateChange>& changes) {
  std::vector<DriverState> states;
  for (const auto& change : changes) states.push_back(change.state);
  return states;
}

TEST(ChangeLog, KeepsTheLatestOfAllAndTellsThemByInstance) {
  ChangeLog log(3);
  for (const auto* id : {"a", "b", "a", "b"})
    log.add({discovery::InstanceId(id), "d"_driver, DriverState::active, "", 0});
  EXPECT_EQ(log.of({}).size(), 3u);
  EXPECT_EQ(log.of("a"_instance).size(), 1u);
  EXPECT_EQ(log.of("b"_instance).size(), 2u);
  EXPECT_THAT(log.of("c"_instance), IsEmpty());
}

TEST(ChangeLog, TheLatestAreToldOfMoreThanAnAnswerHasRoomFor) {
  std::vector<StateChange> changes;
  for (const auto state : {DriverState::starting, DriverState::active, DriverState::failed})
    changes.push_back({"a"_instance, "d"_driver, state, std::string(1000, 'x'), 0});
  EXPECT_THAT(states(latest_of(changes, 2500)), ElementsAre(DriverState::active, DriverState::failed));
  EXPECT_EQ(latest_of(changes, 10'000), changes);
  EXPECT_THAT(latest_of(changes, 1000), IsEmpty());
  EXPECT_THAT(latest_of({}, 1000), IsEmpty());
}

/// A change log in a file, over several runs.
class ChangesOnDisk : public ::testing::Test {
 protected:
  ChangesOnDisk() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-changes-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    file_ = folder_ / "history.jsonl";
  }
  ~ChangesOnDisk() override { std::filesystem::remove_all(folder_); }

  static StateChange change(const std::string& instance, std::int64_t time_ms, const std::string& reason = "") {
    return {discovery::InstanceId(instance), "d"_driver, DriverState::active, reason, time_ms};
  }
  /// What the next run loads.
  std::vector<StateChange> found() const { return ChangeLog(most, file_).of({}); }
  std::string text() const {
    std::ifstream file(file_);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  std::size_t lines() const {
    const std::string all = text();
    return static_cast<std::size_t>(std::count(all.begin(), all.end(), '\n'));
  }

  static constexpr std::size_t most = 3;
  std::filesystem::path folder_;
  std::string file_;
};

TEST_F(ChangesOnDisk, ASlowDiskKeepsNobodyFromReadingThem) {
  std::promise<void> disk;
  const auto done = disk.get_future().share();
  const tests::SyncCalls slow([&](const std::string&) {
    done.wait();
    return 0;
  });
  ChangeLog log(most, file_);
  std::jthread writer([&] { log.add(change("a", 1)); });
  EXPECT_TRUE(tests::eventually([&] { return log.of("a"_instance).size() == 1; }));
  disk.set_value();
}

TEST_F(ChangesOnDisk, TheNameOfAFileThatReplacesTheOldOneIsOnTheDiskToo) {
  const tests::SyncCalls synced;
  ChangeLog log(most, file_);
  log.add(change("a", 1));
  EXPECT_TRUE(synced.contains(folder_.string()));
}

TEST_F(ChangesOnDisk, WhatWasAppendedIsBroughtToTheDiskByTheNextSync) {
  ChangeLog log(most, file_);
  log.add(change("a", 1));
  log.add(change("a", 2));
  const tests::SyncCalls synced;
  log.sync();
  log.sync();
  EXPECT_THAT(synced.paths(), ElementsAre(file_)) << "once: nothing was added since";
  log.add(change("a", 3));
  log.sync();
  EXPECT_THAT(synced.paths(), ElementsAre(file_, file_));
}

TEST_F(ChangesOnDisk, AfterTheDiskFailedTheNextChangeWritesThemAllAgain) {
  ChangeLog log(most, file_);
  log.add(change("a", 1));
  log.add(change("a", 2));
  {
    const tests::SyncCalls failing([](const std::string&) { return EIO; });
    log.sync();
  }
  const tests::SyncCalls synced;
  log.add(change("a", 3));
  EXPECT_TRUE(synced.contains(folder_.string()));
  EXPECT_THAT(found(), ElementsAre(change("a", 1), change("a", 2), change("a", 3)));
}

TEST_F(ChangesOnDisk, AreKnownToTheNextLifeAsTheyWere) {
  const StateChange odd{"b"_instance, "e"_driver, DriverState::failed, "a \"quote\", a line\nbreak", 1'700'000'000'000};
  {
    ChangeLog log(most, file_);
    log.add(change("a", 1));
    log.add(odd);
  }
  EXPECT_THAT(found(), ElementsAre(change("a", 1), odd));
  ChangeLog log(most, file_);
  log.add(change("a", 2));
  EXPECT_THAT(found(), ElementsAre(change("a", 1), odd, change("a", 2)));
}

TEST_F(ChangesOnDisk, AreThereAtOnceForALifeThatIsKilled) {
  ChangeLog log(most, file_);
  for (int i = 1; i <= 3; ++i) {
    log.add(change("a", i));
    EXPECT_EQ(found(), log.of({}));
  }
}

TEST_F(ChangesOnDisk, AreBoundedInNumberAndInTheLengthOfTheirReasons) {
  ChangeLog log(most, file_);
  for (int i = 1; i <= 100; ++i) {
    log.add(change("a", i, std::string(100'000, 'x')));
    EXPECT_LE(lines(), 2 * most);
  }
  EXPECT_LT(text().size(), 2 * most * 2'200);
  EXPECT_EQ(found().size(), most);
  EXPECT_EQ(found().back().time_ms, 100);
  const std::filesystem::directory_iterator left(folder_);
  EXPECT_EQ(std::distance(begin(left), end(left)), 1);
}

TEST_F(ChangesOnDisk, WithATornLastLineAreKnownButForThatOne) {
  { ChangeLog(most, file_).add(change("a", 1)); }
  std::ofstream(file_, std::ios::app) << R"({"driver":"d","insta)";
  EXPECT_THAT(found(), ElementsAre(change("a", 1)));
  { ChangeLog(most, file_).add(change("a", 2)); }
  EXPECT_THAT(found(), ElementsAre(change("a", 1), change("a", 2)));
}

TEST_F(ChangesOnDisk, ThatAreDamagedAreSetAsideWithAWarningAndWhatStoodBeforeIsKept) {
  for (const auto* damage : {"nonsense\n", "{}\n", "[1]\n", "\n",
                             R"({"driver":"d","instance":"a","reason":"","state":"merry","time_ms":1})"
                             "\n"}) {
    std::filesystem::remove(file_);
    { ChangeLog(most, file_).add(change("a", 1)); }
    std::ofstream(file_, std::ios::app) << damage;
    const std::string damaged = text();
    ::testing::internal::CaptureStderr();
    EXPECT_THAT(found(), ElementsAre(change("a", 1))) << damage;
    EXPECT_THAT(::testing::internal::GetCapturedStderr(),
                ::testing::AllOf(HasSubstr(file_), HasSubstr("damaged in line 2"), HasSubstr("set aside as")));
    EXPECT_FALSE(std::filesystem::exists(file_));
    std::ifstream aside(file_ + ".damaged");
    EXPECT_EQ(std::string(std::istreambuf_iterator<char>(aside), {}), damaged);
  }
}

TEST_F(ChangesOnDisk, ThatCannotBeWrittenAreKeptInMemoryUntilTheyCan) {
  std::optional<tests::SyncCalls> disk_fails([](const std::string&) { return EIO; });
  ChangeLog log(most, file_);
  ::testing::internal::CaptureStderr();
  log.add(change("a", 1));
  log.add(change("a", 2));
  const std::string said = ::testing::internal::GetCapturedStderr();
  EXPECT_THAT(said, HasSubstr("cannot be written"));
  EXPECT_EQ(said.find("cannot be written"), said.rfind("cannot be written")) << "said once";
  EXPECT_EQ(log.of({}).size(), 2u);
  disk_fails.reset();
  log.add(change("a", 3));
  EXPECT_EQ(found(), log.of({}));
}

TEST_F(ChangesOnDisk, AreNotToldAgainOfAnInstanceThatIsAsItWas) {
  { ChangeLog(most, file_).add(change("a", 1)); }
  ChangeLog log(most, file_);
  log.add(change("a", 1));
  EXPECT_THAT(log.of({}), ElementsAre(change("a", 1)));
  log.add(change("a", 1));
  EXPECT_EQ(log.of({}).size(), 2u) << "it was something else meanwhile, or somebody means it";
}

class DriverHistory : public GatewayFixture {};

TEST_F(DriverHistory, HasEveryStateOfAnInstanceWithItsTimeItsEndToo) {
  start_gateway();
  give(order("a", {{"channels", "none"}}));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  auto paused = order("a", {{"channels", "none"}});
  paused.active = false;
  give(paused);
  ASSERT_TRUE(comes_to("a", DriverState::inactive));
  take_back("a");
  ASSERT_TRUE(eventually([&] { return states(gateway_->changes("a"_instance)).back() == DriverState::undeployed; }));
  const auto changes = gateway_->changes("a"_instance);
  EXPECT_THAT(states(changes),
              ElementsAre(DriverState::deployed, DriverState::starting, DriverState::active, DriverState::stopping,
                          DriverState::inactive, DriverState::stopping, DriverState::undeployed));
  for (std::size_t i = 0; i < changes.size(); ++i) {
    EXPECT_GT(changes[i].time_ms, 0);
    EXPECT_GE(changes[i].time_ms, changes[i == 0 ? 0 : i - 1].time_ms);
  }
  EXPECT_EQ(changes.back().reason, "as ordered");
}

TEST_F(DriverHistory, OutlivesTheGateway) {
  const auto file = std::filesystem::temp_directory_path() / ("iotcloud-history-" + std::to_string(getpid()));
  const auto live = [&] {
    auto with_file = options();
    with_file.history_file = file;
    gateway_.emplace(with_file);
    gateway_->start();
  };
  live();
  give(order("a", {{"channels", "none"}}));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  gateway_.reset();
  live();
  ASSERT_TRUE(comes_to("a", DriverState::active));
  const auto told = states(gateway_->changes("a"_instance));
  gateway_.reset();
  std::filesystem::remove(file);
  EXPECT_THAT(told,
              ElementsAre(DriverState::deployed, DriverState::starting, DriverState::active, DriverState::stopping,
                          DriverState::inactive, DriverState::deployed, DriverState::starting, DriverState::active));
}

TEST_F(DriverHistory, SaysWhyAnInstanceFailed) {
  start_gateway();
  give(order("a", {{"channels", "none"}, {"throw_in", "open"}}));
  ASSERT_TRUE(comes_to("a", DriverState::failed));
  EXPECT_THAT(gateway_->changes("a"_instance).back().reason, ::testing::HasSubstr("told to throw in open"));
}

}  // namespace
}  // namespace iotcloud::gateway
