// The registry drops sessions, one after another, while clients use everything. Each client must recover completely.
#include <array>
#include <iostream>
#include <map>
#include <random>

#include <iotcloud/tests/discovery/contract_fixture.h>
#include <iotcloud/tests/long.h>

namespace iotcloud::discovery::tests {
namespace {

const int expiries = iotcloud::tests::long_run() ? 1000 : 50;
constexpr int processes = 3;
constexpr int elections = 3;

/// What one process does in the registry.
struct Process {
  Process(std::unique_ptr<Registry> own, int number)
      : name("process-" + std::to_string(number)), registry(std::move(own)) {
    guards.push_back(registry->hold("/held/" + name, "plain"));
    guards.push_back(registry->hold_eventually("/numbered/" + name + "-", "numbered", true));
    guards.push_back(registry->hold_eventually("/contended", name));
    guards.push_back(registry->watch_node("/value", [this](const auto& node) { value.add(text(node)); }));
    guards.push_back(registry->watch_children("/held", [this](const auto& names) { held.add(text(names)); }));
    guards.push_back(registry->on_session([this](SessionState state) {
      if (state == SessionState::expired) ++expired;
    }));
    for (int i = 0; i < elections; ++i) {
      Election::Callbacks callbacks;
      callbacks.on_elected = [this, i](std::int64_t epoch) { epochs[static_cast<std::size_t>(i)].add(epoch); };
      callbacks.on_lost = [] {};
      stands.push_back(std::make_unique<Election>(*registry, "/elections/" + std::to_string(i), name, callbacks));
    }
    caller = std::thread([this] { call(); });
  }
  ~Process() {
    stop = true;
    caller.join();
  }

  /// Calls, and watches and elections that begin and end, all the time.
  void call() {
    for (int i = 0; !stop; ++i) {
      try {
        put(*registry, "/calls/" + name, std::to_string(i));
        registry->get_all({"/value", "/held", "/calls/" + name});
        const auto watch = registry->watch_node("/value", [](const auto&) {});
        const Election passing(*registry, "/elections/passing", name, {[](std::int64_t) {}, [] {}});
        const auto held_shortly = registry->hold_eventually("/short/" + name, "");
        ++calls;
      } catch (const RegistryError& error) {
        if (error.code() != RegistryErrorCode::away) ++refused;
        ++away;
      }
    }
  }

  const std::string name;
  Seen<std::string> value, held;
  std::array<Seen<std::int64_t>, elections> epochs;
  std::atomic<int> expired{0}, calls{0}, away{0}, refused{0};
  std::atomic<bool> stop{false};
  std::unique_ptr<Registry> registry;
  std::vector<std::unique_ptr<Election>> stands;
  std::vector<GuardPtr> guards;
  std::thread caller;
};

class Expiry : public RegistryContract {};

TEST_P(Expiry, EverythingComesBackEachTime) {
  std::vector<std::unique_ptr<Process>> all;
  all.reserve(processes);
  for (int i = 0; i < processes; ++i) all.push_back(std::make_unique<Process>(client(std::chrono::seconds(5)), i));
  std::mt19937 choose(20261121);
  for (int round = 0; round < expiries; ++round) {
    const std::string held = "/held/" + all[choose() % processes]->name;
    std::optional<Node> before;  // on a busy machine a session may also have expired by itself
    ASSERT_TRUE(eventually([&] { return (before = other_->get(held)).has_value(); }))
        << held << " was not back before expiry " << round;
    place_->expire(before->owner_session);
    ASSERT_TRUE(eventually([&] {
      const auto now = other_->get(held);
      return now && now->owner_session != before->owner_session;
    })) << held
        << " did not come back after expiry " << round << ": a deadlock?";
    put(*registry_, "/value", std::to_string(round));
  }

  const std::string last = std::to_string(expiries - 1);
  int watches_behind = 0, held_lost = 0, without_leader = 0, epochs_again = 0, told = 0, calls = 0, away = 0;
  std::array<std::map<std::int64_t, std::string>, elections> used;  // who used it
  std::string names;
  for (const auto& process : all) names += (names.empty() ? "" : " ") + process->name;
  for (const auto& process : all) {
    watches_behind += process->value.wait_for_last(last) ? 0 : 1;
    watches_behind += process->held.wait_for_last(names) ? 0 : 1;
    held_lost += other_->get("/held/" + process->name) ? 0 : 1;
    told += process->expired;
    calls += process->calls;
    away += process->away;
    EXPECT_EQ(process->refused, 0);
  }
  held_lost += eventually([&] { return other_->children("/numbered").value().size() == processes; }) ? 0 : 1;
  held_lost += eventually([&] { return other_->get("/contended").has_value(); }) ? 0 : 1;
  for (std::size_t i = 0; i < elections; ++i) {
    without_leader += eventually([&] {
      int leaders = 0;
      for (const auto& process : all) leaders += process->stands[i]->leading() ? 1 : 0;
      return leaders == 1;
    })
                          ? 0
                          : 1;
    for (const auto& process : all) {
      // A candidate that was out of contact too long but finds its node still there leads again under the same epoch.
      for (const std::int64_t epoch : process->epochs[i].all()) {
        epochs_again += used[i].try_emplace(epoch, process->name).first->second == process->name ? 0 : 1;
      }
    }
  }
  std::cout << expiries << " sessions expired (" << GetParam() << "), of which the clients were told " << told << ": "
            << held_lost << " held nodes lost, " << watches_behind << " watches missed the last state, "
            << without_leader << " elections without their leader, " << epochs_again << " epochs used by two; " << calls
            << " rounds of calls, " << away << " of them unanswered\n";
  EXPECT_EQ(held_lost, 0);
  EXPECT_EQ(watches_behind, 0);
  EXPECT_EQ(without_leader, 0);
  EXPECT_EQ(epochs_again, 0);
}

INSTANTIATE_TEST_SUITE_P(Registries, Expiry, testing::Values("embedded", "zookeeper"),
                         [](const auto& parameter) { return parameter.param; });

}  // namespace
}  // namespace iotcloud::discovery::tests
