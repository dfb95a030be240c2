// Drivers that fall ill in driver hosts that are real processes, beside one that must not notice.
#include <fstream>

#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/fleet/process_fixture.h>
#include <iotcloud/tests/gateway/status_log.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::AllOf;
using ::testing::HasSubstr;
using namespace std::chrono_literals;
namespace fs = std::filesystem;

class SelfHealing : public ProcessTest {
 protected:
  /// A healthy driver runs and keeps its diary; the history of the sick one's record is collected.
  void start(std::map<std::string, std::string> illness, int give_up_after = 100) {
    auto with_policy = options();
    with_policy.restart = {1ms, 50ms, 1h, give_up_after};
    gateway_.emplace(std::move(with_policy));
    gateway_->start();
    fs::copy(fs::path(TEST_PLUGINS) / "sick.so", plugins_ / "healthy.so");
    give(quiet("well", "healthy.so", {{"diary", diary_}}));
    ASSERT_TRUE(comes_to("well", DriverState::active, "healthy"));
    watch_ = registry_->watch_node(paths_.instance("sick"_driver, "ill"_instance), [&](const auto& node) {
      if (!node) return;
      const auto record = discovery::decode_driver(node->data, "ill");
      told_.add({"ill"_instance, record.name, record.state, record.reason, record.since_ms, {}, {}});
    });
    if (!illness.contains("trigger")) illness["trigger"] = trigger_;
    give(quiet("ill", "sick.so", std::move(illness)));
  }

  /// \return StatusLog::why_it_runs_again().
  std::string falls_ill_and_runs_again() {
    if (!told_.wait_for("ill", DriverState::active)) return "it never ran";
    tests::write_file(trigger_, "");
    return told_.why_it_runs_again("ill");
  }

  /// Its numbers without a gap, all of one process.
  void expect_healthy() {
    const auto lines = [&] {
      std::vector<std::pair<int, int>> all;
      std::ifstream in(diary_);
      for (int process = 0, number = 0; in >> process >> number;) all.emplace_back(process, number);
      return all;
    };
    const auto before = lines().size();
    EXPECT_TRUE(eventually([&] { return lines().size() > before + 5; })) << "it does not run any more";
    const auto all = lines();
    for (std::size_t i = 0; i < all.size(); ++i) {
      ASSERT_EQ(all[i].first, all[0].first) << "it was started again";
      ASSERT_EQ(all[i].second, static_cast<int>(i) + 1);
    }
  }

  const std::string trigger_ = folder_ / "trigger", diary_ = folder_ / "diary";
  StatusLog told_;
  discovery::GuardPtr watch_;
};

TEST_F(SelfHealing, ADriverThatSegfaultsRunsAgainAndAHealthyOneMissesNothing) {
  start({{"illness", "segfault"}});
  EXPECT_THAT(falls_ill_and_runs_again(), HasSubstr("crashed (signal 11"));
  expect_healthy();
}

TEST_F(SelfHealing, ADriverThatHangsIsKilledByNameAndRunsAgain) {
  start({{"illness", "hang"}, {"hang_limit", "500ms"}});  // not all hosts': a busy machine keeps a healthy one waiting
  EXPECT_THAT(falls_ill_and_runs_again(), HasSubstr("hung: a callback of ill has been running for"));
  expect_healthy();
}

TEST_F(SelfHealing, ADriverThatHangsOnItsOwnThreadIsKilledByNameAndRunsAgain) {
  own_thread_hang_limit_ = 500ms;
  start({{"illness", "hang"}, {"thread", "own"}});
  EXPECT_THAT(falls_ill_and_runs_again(), HasSubstr("hung: a callback of ill has been running for"));
  expect_healthy();
}

TEST_F(SelfHealing, AnInstanceSaysItselfAfterHowLongItHangs) {
  start({{"illness", "hang"}, {"thread", "own"}, {"hang_limit", "300ms"}});
  EXPECT_THAT(falls_ill_and_runs_again(), HasSubstr("hung: a callback of ill has been running for"));
}

TEST_F(SelfHealing, ADriverThatLeaksIsKilledAtItsLimitAndRunsAgain) {
  limits_.memory_bytes = std::uint64_t{600} << 20;  // a sanitizer takes much for itself
  start({{"illness", "leak"}});
  EXPECT_THAT(falls_ill_and_runs_again(), AllOf(HasSubstr("MiB of memory"), HasSubstr("its limit of 600 MiB")));
  expect_healthy();
}

TEST_F(SelfHealing, ADriverThatSpinsIsKilledAndRunsAgain) {
  limits_.spin = 2s;
  start({{"illness", "spin"}});
  EXPECT_THAT(falls_ill_and_runs_again(), HasSubstr("spun: its thread sick has not slept for"));
  expect_healthy();
}

TEST_F(SelfHealing, ADriverThatFailsAgainAndAgainIsLeftAloneUntilItIsTold) {
  start({{"illness", "exit"}, {"trigger", ""}}, 3);
  const auto failed = told_.wait_for("ill", DriverState::failed);
  ASSERT_TRUE(failed);
  EXPECT_THAT(failed->reason, AllOf(HasSubstr("exited with status 3"), HasSubstr("failure 3 in a row")));
  auto cured = quiet("ill", "sick.so", {{"illness", ""}});
  give(cured);
  EXPECT_TRUE(told_.wait_for("ill", DriverState::active));
  expect_healthy();
}

}  // namespace
}  // namespace iotcloud::gateway
