// What a worker does not read yet: units of its share that somebody else still has, and all of them after the fence.
#include <algorithm>
#include <chrono>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include <iotcloud/discovery/embedded/server.h>
#include <iotcloud/tests/discovery/passing_registry.h>
#include <iotcloud/tests/topology/endpoints/endpoints_fixture.h>
#include <iotcloud/topology/endpoints/standstill_fence.h>

namespace iotcloud::topology {
namespace {

/// Its timers go off when the test says, once it has stopped them. Asked for a group's member while it is silent, it
/// stops them by itself, and answers when the test says. Thread safe.
class StoppedTimers final : public tests::PassingRegistry {
 public:
  using PassingRegistry::PassingRegistry;

  void stop() {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
  }
  void go_off() { let_begin(stopped_, waiting_); }
  void be_silent() {
    const std::lock_guard lock(mutex_);
    silent_ = true;
  }
  /// How often it was asked and did not answer.
  std::size_t asked() const {
    const std::lock_guard lock(mutex_);
    return questions_.size();
  }
  void answer() { let_begin(silent_, questions_); }
  /// Whether a group's members, as it has read them last, have one of this name.
  bool has_read(const std::string& member) const {
    const std::lock_guard lock(mutex_);
    return std::find(members_.begin(), members_.end(), member) != members_.end();
  }
  /// For how many units somebody stands.
  int candidacies() const {
    const std::lock_guard lock(mutex_);
    return candidacies_;
  }
  /// Returns when all callbacks that waited have run.
  void let_callbacks_run() {
    std::promise<void> reached;
    const auto last = PassingRegistry::after(std::chrono::milliseconds(0), [&] { reached.set_value(); });
    reached.get_future().wait();
  }

  discovery::GuardPtr watch_children(const std::string& path,
                                     std::function<void(const std::optional<Names>&)> callback) override {
    if (!path.ends_with("/members")) return PassingRegistry::watch_children(path, std::move(callback));
    return PassingRegistry::watch_children(path, [this, callback = std::move(callback)](const auto& names) {
      callback(names);  // which reads them
      const std::lock_guard lock(mutex_);
      members_ = names.value_or(Names());
    });
  }
  discovery::GuardPtr watch_node(const std::string& path,
                                 std::function<void(const std::optional<Node>&)> callback) override {
    const std::lock_guard lock(mutex_);
    if (!silent_ || path.find("/members/") == std::string::npos)
      return PassingRegistry::watch_node(path, std::move(callback));
    stopped_ = true;
    questions_.push_back(std::make_shared<Timer>([callback = std::move(callback)] { callback(std::nullopt); }));
    return std::make_unique<TimerGuard>(questions_.back());
  }
  discovery::GuardPtr hold_eventually(const std::string& path, const std::string& data, bool sequential,
                                      std::function<void(const std::string&)> on_created) override {
    {
      const std::lock_guard lock(mutex_);
      if (path.find("/units/") != std::string::npos) ++candidacies_;
    }
    return PassingRegistry::hold_eventually(path, data, sequential, std::move(on_created));
  }
  discovery::GuardPtr after(std::chrono::milliseconds pause, std::function<void()> callback) override {
    const std::lock_guard lock(mutex_);
    if (!stopped_) return PassingRegistry::after(pause, std::move(callback));
    waiting_.push_back(std::make_shared<Timer>(std::move(callback)));
    return std::make_unique<TimerGuard>(waiting_.back());
  }

 private:
  class Timer {
   public:
    explicit Timer(std::function<void()> callback) : callback_(std::move(callback)) {}
    void begin(StoppedTimers& registry) {
      const std::lock_guard lock(mutex_);
      if (callback_) running_ = registry.PassingRegistry::after(std::chrono::milliseconds(0), std::move(callback_));
    }
    void cancel() {
      discovery::GuardPtr running;
      const std::lock_guard lock(mutex_);
      callback_ = nullptr;
      running.swap(running_);
    }

   private:
    std::mutex mutex_;
    std::function<void()> callback_;  ///< guarded by mutex_
    discovery::GuardPtr running_;     ///< guarded by mutex_
  };
  class TimerGuard final : public discovery::Guard {
   public:
    explicit TimerGuard(std::shared_ptr<Timer> timer) : timer_(std::move(timer)) {}
    ~TimerGuard() override { timer_->cancel(); }
    TimerGuard(const TimerGuard&) = delete;
    TimerGuard& operator=(const TimerGuard&) = delete;

   private:
    const std::shared_ptr<Timer> timer_;
  };

  /// Ends what holds timers up, and lets those begin that waited for that.
  void let_begin(bool& held_up, std::vector<std::shared_ptr<Timer>>& timers) {
    std::vector<std::shared_ptr<Timer>> waiting;
    {
      const std::lock_guard lock(mutex_);
      held_up = false;
      waiting.swap(timers);
    }
    for (const auto& timer : waiting) timer->begin(*this);
  }

  mutable std::mutex mutex_;
  bool stopped_ = false;                           ///< guarded by mutex_
  bool silent_ = false;                            ///< guarded by mutex_
  Names members_;                                  ///< guarded by mutex_
  int candidacies_ = 0;                            ///< guarded by mutex_
  std::vector<std::shared_ptr<Timer>> waiting_;    ///< guarded by mutex_
  std::vector<std::shared_ptr<Timer>> questions_;  ///< guarded by mutex_
};

WorkerOptions with_a_spout(discovery::Registry& registry, config::Metrics& metrics) {
  return {.definition = TopologyDefinition::parse(
              "topology.name: t\nspouts:\n  in: {broker: rabbitmq, driver: d, channel: up, builder: text, "
              "fields: [text, driverID, time]}\n",
              "t.yaml"),
          .components = {},
          .library_folders = {},
          .registry = &registry,
          .clock = nullptr,
          .metrics = &metrics};
}

int channels_read(const config::Metrics& metrics) {
  for (const auto& sample : metrics.collect()) {
    if (sample.name == "iotcloud_spout_channels") return static_cast<int>(sample.value);
  }
  return 0;
}

TEST_F(Endpoints, UnitsThatAWorkerGaveAwayAndGotBackBeforeItReadThemAreRead) {
  constexpr int drivers = 4;
  const std::string group = "/iot/groups/t/d/up";
  std::vector<discovery::GuardPtr> others;  // that read the units
  std::vector<std::string> names;
  for (int i = 0; i < drivers; ++i) {
    names.push_back("i" + std::to_string(i));
    others.push_back(registry_->hold(group + "/units/instance-" + names.back(), "somebody"));
    show_driver(names.back());
  }
  StoppedTimers registry{discovery::make_registry({.url = url_})};
  config::Metrics metrics;
  Worker worker(with_a_spout(registry, metrics));
  worker.start();
  ASSERT_TRUE(eventually([&] { return registry.candidacies() == drivers; })) << "it is alone, and stands for all units";

  registry.stop();
  auto joined =
      registry_->hold(group + "/members/another",
                      R"({"topology":"t","tasks":1,"shares":false,"broker":"rabbitmq","where":"","since":1})");
  ASSERT_TRUE(eventually([&] { return registry.has_read("another"); }));
  joined.reset();
  ASSERT_TRUE(eventually([&] { return !registry.has_read("another"); }));
  registry.go_off();
  registry.let_callbacks_run();

  others.clear();
  EXPECT_TRUE(eventually([&] { return channels_read(metrics) == drivers; }))
      << channels_read(metrics) << " of " << drivers << " are read";
}

TEST_F(Endpoints, ARegistryThatIsSilentAfterTheFenceHoldsNothingElseUpAndNothingIsReadBeforeItsAnswer) {
  show_driver("i");
  StoppedTimers registry{discovery::make_registry({.url = url_})};
  config::Metrics metrics;
  auto options = with_a_spout(registry, metrics);
  const auto fence = std::make_shared<StandstillFence>();
  options.fence = fence;
  Worker worker(std::move(options));
  worker.start();
  ASSERT_TRUE(eventually([&] { return channels_read(metrics) == 1; }));

  registry.be_silent();
  fence->raise();
  fence->beat();
  ASSERT_TRUE(eventually([&] { return registry.asked() == 1; }));
  registry.let_callbacks_run();
  EXPECT_EQ(channels_read(metrics), 0);
  registry.answer();
  registry.let_callbacks_run();
  EXPECT_EQ(channels_read(metrics), 0) << "what the registry says of elections is heard first";
  registry.go_off();
  EXPECT_TRUE(eventually([&] { return channels_read(metrics) == 1; }));
}

TEST_F(Endpoints, AfterTheFenceARegistryThatWasAwayIsAskedAgain) {
  show_driver("i");
  StoppedTimers registry{discovery::make_registry({.url = url_})};
  const auto server = discovery::embedded::RegistryServer::named(url_.substr(url_.find("//") + 2));
  config::Metrics metrics;
  auto options = with_a_spout(registry, metrics);
  const auto fence = std::make_shared<StandstillFence>();
  options.fence = fence;
  Worker worker(std::move(options));
  worker.start();
  ASSERT_TRUE(eventually([&] { return channels_read(metrics) == 1; }));

  const auto session = server->sessions().back();
  registry.be_silent();
  fence->raise();
  fence->beat();
  ASSERT_TRUE(eventually([&] { return registry.asked() == 1; }));
  server->partition(session);
  ASSERT_TRUE(eventually([&] { return registry.session() != discovery::SessionState::connected; }));
  server->restore(session);
  ASSERT_TRUE(eventually([&] { return registry.session() == discovery::SessionState::connected; }));
  registry.let_callbacks_run();
  registry.go_off();
  EXPECT_TRUE(eventually([&] { return registry.asked() == 2; }))
      << "what it says now may be earlier than what it has to say of elections";
}

}  // namespace
}  // namespace iotcloud::topology
