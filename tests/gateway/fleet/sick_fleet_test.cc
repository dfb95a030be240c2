// All that can befall drivers, at the same time, beside one that must not notice.
#include <algorithm>
#include <array>
#include <chrono>
#include <fstream>
#include <iostream>

#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/fleet/process_fixture.h>
#include <iotcloud/tests/gateway/status_log.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::HasSubstr;
using namespace std::chrono_literals;
namespace fs = std::filesystem;

struct Illness {
  std::string name;    ///< of the plugin and of its only instance, too
  std::string reason;  ///< what the record says of it
};
const std::array<Illness, 4> illnesses = {{{"segfault", "crashed (signal 11"},
                                           {"hang", "hung: a callback of hang has been running for"},
                                           {"leak", "MiB of memory, more than its limit"},
                                           {"spin", "spun: its thread"}}};

class SickFleet : public ProcessTest {
 protected:
  SickFleet() {
    limits_.memory_bytes = std::uint64_t{600} << 20;  // a sanitizer takes much for itself
    limits_.spin = 10s;                               // and it does not sleep meanwhile
  }

  std::string trigger(const std::string& illness) const { return folder_ / ("trigger-" + illness); }

  void deploy(const std::string& name, std::map<std::string, std::string> properties) {
    fs::copy(fs::path(TEST_PLUGINS) / "sick.so", plugins_ / (name + ".so"));
    watches_.push_back(registry_->watch_node(paths_.instance(discovery::DriverName(name), discovery::InstanceId(name)),
                                             [this, name](const auto& node) {
                                               if (!node) return;
                                               const auto record = discovery::decode_driver(node->data, name);
                                               told_.add({discovery::InstanceId(name),
                                                          discovery::DriverName(name),
                                                          record.state,
                                                          record.reason,
                                                          record.since_ms,
                                                          {},
                                                          {}});
                                             }));
    give(quiet(name, name + ".so", std::move(properties)));
  }

  StatusLog told_;
  std::vector<discovery::GuardPtr> watches_;
};

TEST_F(SickFleet, EachIsToldApartAndRunsAgainAndTheHealthyOneMissesNothing) {
  auto with_policy = options();
  with_policy.restart = {1ms, 50ms, 1h, 100};
  gateway_.emplace(std::move(with_policy));
  gateway_->start();
  const std::string diary = folder_ / "diary";
  deploy("well", {{"diary", diary}});
  ASSERT_TRUE(told_.wait_for("well", DriverState::active));
  for (const auto& [name, reason] : illnesses) {
    std::map<std::string, std::string> properties = {{"illness", name}, {"trigger", trigger(name)}};
    if (name == "hang") properties["hang_limit"] = "4s";  // not all hosts': a busy machine keeps a healthy one waiting
    deploy(name, std::move(properties));
    ASSERT_TRUE(told_.wait_for(name, DriverState::active)) << name;
  }

  const auto begin = std::chrono::steady_clock::now();
  for (const auto& [name, reason] : illnesses) tests::write_file(trigger(name), "");
  for (const auto& [name, reason] : illnesses) {
    const std::string why = told_.why_it_runs_again(name);
    EXPECT_THAT(why, HasSubstr(reason)) << name;
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;
    std::cout << name << ": seen to run again after " << took.count() << " s at most; " << why << '\n';
  }

  int process = 0, entries = 0, others = 0, missing = 0;
  std::ifstream in(diary);
  for (int writer = 0, number = 0, last = 0; in >> writer >> number; last = number) {
    if (process == 0) process = writer;
    others += writer != process ? 1 : 0;
    missing += number != last + 1 ? 1 : 0;
    ++entries;
  }
  std::cout << "the healthy one: " << entries << " entries meanwhile, " << missing << " missing, " << others
            << " of another process than the first\n";
  EXPECT_GT(entries, 100);
  EXPECT_EQ(missing, 0);
  EXPECT_EQ(others, 0);
  const auto states = told_.states("well");
  const auto active = std::find(states.begin(), states.end(), DriverState::active);
  EXPECT_EQ(std::count(active, states.end(), DriverState::active), states.end() - active) << "it was started again";
}

}  // namespace
}  // namespace iotcloud::gateway
