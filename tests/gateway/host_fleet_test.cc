#include <future>

#include <gmock/gmock.h>

#include <iotcloud/gateway/fleet/host_fleet.h>
#include <iotcloud/tests/gateway/status_log.h>

namespace iotcloud::gateway {
namespace {

brokers::BrokerSetting setting(const std::string& name, const std::string& type, std::vector<std::string> urls) {
  brokers::BrokerSetting setting{name, type, {}};
  setting.options.urls = std::move(urls);
  return setting;
}

using discovery::DriverState;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

/// Launches hosts that do nothing but remember; the test plays them.
class PlayedLauncher final : public HostLauncher {
 public:
  struct Host {
    HostOrder order;
    HostEvents events;
    std::vector<std::string> commands;  ///< "create a", ...
  };

  std::unique_ptr<HostLink> launch(const HostOrder& order, HostEvents events) override {
    hosts.push_back(std::make_shared<Host>(Host{order, std::move(events), {}}));
    return std::make_unique<Link>(hosts.back());
  }
  std::vector<RunningHost> running(const std::string&) override { return found; }
  std::unique_ptr<HostLink> adopt(const RunningHost& host, HostEvents events) override {
    return launch(host.order, std::move(events));
  }

  std::vector<std::shared_ptr<Host>> hosts;  ///< loop's thread only
  std::vector<RunningHost> found;

 private:
  struct Link final : HostLink {
    explicit Link(std::shared_ptr<Host> of) : host(std::move(of)) {}
    void create(const InstanceSpec& spec) override { host->commands.push_back("create " + spec.order.instance); }
    void activate(const std::string& instance) override { host->commands.push_back("activate " + instance); }
    void deactivate(const std::string& instance) override { host->commands.push_back("deactivate " + instance); }
    void remove(const std::string& instance) override { host->commands.push_back("remove " + instance); }
    void shutdown(std::chrono::milliseconds) override { host->commands.push_back("shutdown"); }
    std::shared_ptr<Host> host;
  };
};

class HostFleetTest : public ::testing::Test {
 protected:
  HostFleetTest() {
    HostFleet::Options options;
    options.gateway = "gw";
    options.restart = {1ms, 4ms, 1h, give_up_after};
    options.clock = &config::system_clock();
    fleet_.emplace(loop_, launcher_, Placement({setting("b", "embedded", {"embedded://x"})}), options,
                   [this](const auto& status) { log_.add(status); });
  }
  ~HostFleetTest() override { loop_.stop(); }

  /// Runs on the loop, after what was posted before.
  void on_loop(const std::function<void()>& call) {
    std::promise<void> done;
    loop_.post([&] {
      call();
      done.set_value();
    });
    done.get_future().wait();
  }
  static discovery::OrderRecord order(const std::string& instance, const std::string& plugin = "p.so") {
    discovery::OrderRecord order;
    order.instance = instance;
    order.plugin = plugin;
    return order;
  }
  static InstanceStatus status(const std::string& instance, DriverState state) {
    InstanceStatus status;
    status.instance = instance;
    status.driver = "p";
    status.state = state;
    return status;
  }
  std::vector<std::string> commands(std::size_t host) {
    std::vector<std::string> commands;
    on_loop([&] { commands = launcher_.hosts.at(host)->commands; });
    return commands;
  }
  void wait_for_hosts(std::size_t count) {
    for (std::size_t now = 0; now < count;) on_loop([&] { now = launcher_.hosts.size(); });
  }
  void tell(std::size_t host, const InstanceStatus& told) {
    on_loop([&] { launcher_.hosts.at(host)->events.on_status(told); });
  }
  void end(std::size_t host, HostEnd::How how, const std::string& reason) {
    on_loop([&] { launcher_.hosts.at(host)->events.on_ended({how, reason, ""}); });
  }

  static constexpr int give_up_after = 6;
  PlayedLauncher launcher_;
  StatusLog log_;
  EventLoop loop_{"fleet"};
  std::optional<HostFleet> fleet_;
};

TEST_F(HostFleetTest, InstancesOfOnePluginShareAHostAndPluginsDoNot) {
  on_loop([&] {
    fleet_->create(order("a"));
    fleet_->create(order("b"));
    fleet_->create(order("c", "q.so"));
  });
  EXPECT_THAT(commands(0), ElementsAre("create a", "create b"));
  EXPECT_THAT(commands(1), ElementsAre("create c"));
}

TEST_F(HostFleetTest, TheLastInstanceEndsItsHostAndANewOneGetsANewHost) {
  on_loop([&] { fleet_->create(order("a")); });
  on_loop([&] { fleet_->remove("a"); });
  tell(0, status("a", DriverState::undeployed));
  EXPECT_THAT(commands(0), ElementsAre("create a", "remove a", "shutdown"));
  on_loop([&] { fleet_->create(order("a")); });
  EXPECT_THAT(commands(1), ElementsAre("create a"));
}

TEST_F(HostFleetTest, ACrashedHostIsStartedAgainWithItsInstancesAndTheirStateSaysSo) {
  on_loop([&] {
    fleet_->create(order("a"));
    fleet_->create(order("failed"));
    fleet_->create(order("leaving"));
    fleet_->create(order("other", "q.so"));
  });
  tell(0, status("a", DriverState::active));
  tell(0, status("failed", DriverState::failed));
  tell(1, status("other", DriverState::active));
  on_loop([&] { fleet_->remove("leaving"); });
  end(0, HostEnd::How::crashed, "crashed (signal 11)");
  const auto told = log_.wait_for("a", DriverState::starting);
  ASSERT_TRUE(told);
  EXPECT_THAT(told->reason, HasSubstr("crashed (signal 11); it is started again in 1 ms"));
  EXPECT_TRUE(log_.wait_for("leaving", DriverState::undeployed));
  wait_for_hosts(3);
  EXPECT_THAT(commands(2), ElementsAre("create a"));  // one that failed by itself stays failed
  EXPECT_THAT(log_.states("other"), ElementsAre(DriverState::deployed, DriverState::active));
  EXPECT_THAT(log_.states("failed"), ElementsAre(DriverState::deployed, DriverState::failed));
  tell(2, status("a", DriverState::active));
  const auto again = log_.wait_for("a", DriverState::active);
  ASSERT_TRUE(again);
  EXPECT_EQ(again->reason, "again, after its driver host crashed (signal 11)");
}

TEST_F(HostFleetTest, AHostThatFailsTooOftenInARowIsLeftAloneUntilItIsOrderedAnew) {
  on_loop([&] {
    fleet_->create(order("a"));
    fleet_->create(order("b"));
  });
  for (std::size_t host = 0; host < give_up_after; ++host) {
    wait_for_hosts(host + 1);
    tell(host, status("a", DriverState::active));
    end(host, HostEnd::How::crashed, "crashed");
  }
  const auto failed = log_.wait_for("a", DriverState::failed);
  ASSERT_TRUE(failed);
  EXPECT_THAT(failed->reason, HasSubstr("failure 6 in a row"));
  EXPECT_TRUE(log_.wait_for("b", DriverState::failed));
  on_loop([&] { EXPECT_EQ(launcher_.hosts.size(), give_up_after); });
  on_loop([&] {
    fleet_->remove("a");
    fleet_->create(order("a"));
  });
  EXPECT_THAT(commands(give_up_after), ElementsAre("create a"));
  end(give_up_after, HostEnd::How::crashed, "crashed");
  wait_for_hosts(give_up_after + 2);  // its count began anew
}

TEST_F(HostFleetTest, WhereOneInstanceIsAtFaultOnlyThatOneIsLeftAlone) {
  on_loop([&] {
    fleet_->create(order("good"));
    fleet_->create(order("bad"));
  });
  for (std::size_t host = 0; host < give_up_after; ++host) {
    wait_for_hosts(host + 1);
    on_loop([&] { launcher_.hosts.at(host)->events.on_ended({HostEnd::How::crashed, "hung", "bad"}); });
  }
  ASSERT_TRUE(log_.wait_for("bad", DriverState::failed));
  wait_for_hosts(give_up_after + 1);
  EXPECT_THAT(commands(give_up_after), ElementsAre("create good"));
  EXPECT_THAT(log_.states("good"), ::testing::Not(::testing::Contains(DriverState::failed)));
}

TEST_F(HostFleetTest, AHostThatSomeoneElseEndsIsStartedAgainWithItsInstances) {
  on_loop([&] { fleet_->create(order("a")); });
  tell(0, status("a", DriverState::undeployed));  // it closed its instances, as it was told to by a signal
  end(0, HostEnd::How::crashed, "exited with status 0");
  wait_for_hosts(2);
  EXPECT_THAT(commands(1), ElementsAre("create a"));
  EXPECT_THAT(log_.states("a"), ::testing::Not(::testing::Contains(DriverState::undeployed)));
}

TEST_F(HostFleetTest, AHostThatCrashesAgainAndAgainWaitsLongerUpToALimit) {
  on_loop([&] { fleet_->create(order("a")); });
  for (const auto* delay : {"in 1 ms", "in 2 ms", "in 4 ms", "in 4 ms"}) {
    std::size_t last = 0;
    on_loop([&] { last = launcher_.hosts.size() - 1; });
    end(last, HostEnd::How::crashed, "crashed");
    const auto told = log_.wait_for("a", DriverState::starting);
    ASSERT_TRUE(told);
    EXPECT_THAT(told->reason, HasSubstr(delay));
    wait_for_hosts(last + 2);
  }
}

TEST_F(HostFleetTest, ARefusedPluginFailsItsInstancesAndIsNotStartedAgain) {
  on_loop([&] { fleet_->create(order("a")); });
  end(0, HostEnd::How::refused, "wrong SDK");
  const auto failed = log_.wait_for("a", DriverState::failed);
  ASSERT_TRUE(failed);
  EXPECT_EQ(failed->reason, "wrong SDK");
  on_loop([&] {
    fleet_->activate("a");
    fleet_->deactivate("a");
    fleet_->remove("a");
  });
  EXPECT_TRUE(log_.wait_for("a", DriverState::undeployed));
  on_loop([&] { EXPECT_EQ(launcher_.hosts.size(), 1u); });
}

TEST_F(HostFleetTest, InstancesOfAHostThatRunsAlreadyAreAdopted) {
  RunningHost running;
  running.name = "h";
  running.order = {"p.so", "gw", false};
  HostedInstance hosted;
  hosted.spec.order = order("a");
  hosted.status = status("a", DriverState::active);
  running.instances = {hosted};
  launcher_.found = {running};
  on_loop([&] {
    EXPECT_EQ(fleet_->adopt().size(), 1u);
    fleet_->create(order("b"));  // joins the adopted host
    fleet_->deactivate("a");
  });
  EXPECT_THAT(commands(0), ElementsAre("create b", "deactivate a"));
}

TEST_F(HostFleetTest, ShuttingDownEndsEveryHost) {
  std::promise<void> done;
  on_loop([&] {
    fleet_->create(order("a"));
    fleet_->create(order("b", "q.so"));
    fleet_->shutdown(1s, [&] { done.set_value(); });
  });
  tell(0, status("a", DriverState::undeployed));
  end(0, HostEnd::How::stopped, "");
  end(1, HostEnd::How::stopped, "did not shut down in time and was killed");
  EXPECT_EQ(done.get_future().wait_for(20s), std::future_status::ready);
  EXPECT_TRUE(log_.wait_for("a", DriverState::undeployed));
  EXPECT_TRUE(log_.wait_for("b", DriverState::undeployed));
}

TEST(Placement, GroupsOfBothKindsTakeTurnsOverTheServers) {
  Placement placement({setting("r", "rabbitmq", {"u1", "u2"})});
  const auto first = placement.place("turtle").at(0);
  const auto second = placement.place("turtle").at(0);
  const auto third = placement.place("lamp").at(0);
  EXPECT_EQ(first.exclusive_urls.front(), "u1");
  EXPECT_EQ(second.exclusive_urls.front(), "u2");
  EXPECT_EQ(third.exclusive_urls.front(), "u1");
  EXPECT_EQ(first.shared_urls.front(), "u1");
  EXPECT_EQ(second.shared_urls.front(), "u1") << "the shared group stays in one place";
  EXPECT_EQ(third.shared_urls.front(), "u2");
  EXPECT_EQ(second.exclusive_urls, (std::vector<std::string>{"u2", "u1"})) << "the others follow, for fail-over";
}

TEST(Placement, TheSharedGroupOfAnAdoptedInstanceStaysWhereItIs) {
  Placement placement({setting("r", "rabbitmq", {"u1", "u2"})});
  placement.learn("turtle", {{"r", "rabbitmq", {}, {"u1", "u2"}, {"u2", "u1"}}});
  EXPECT_EQ(placement.place("turtle").at(0).shared_urls.front(), "u2");
}

}  // namespace
}  // namespace iotcloud::gateway
