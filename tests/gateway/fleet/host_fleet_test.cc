#include <algorithm>
#include <future>
#include <tuple>

#include <gmock/gmock.h>

#include <iotcloud/discovery/channel_names.h>
#include <iotcloud/gateway/fleet/host_fleet.h>
#include <iotcloud/gateway/fleet/report_check.h>
#include <iotcloud/tests/config/hand_clock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/gateway/status_log.h>

namespace iotcloud::gateway {
namespace {

brokers::BrokerSetting setting(const std::string& name, const std::string& type, std::vector<std::string> urls) {
  brokers::BrokerSetting setting{name, type, {}};
  setting.options.urls = std::move(urls);
  return setting;
}

using discovery::DriverState;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;
using namespace std::chrono_literals;

/// Launches hosts that do nothing but remember; the test plays them.
class PlayedLauncher final : public HostLauncher {
 public:
  struct Host {
    HostOrder order;
    HostEvents events;
    std::vector<std::string> commands;  ///< "create a", ...
    std::int64_t delivered = 0;         ///< the number of the last message passed to it
  };

  std::unique_ptr<HostLink> launch(const HostOrder& order, HostEvents events) override {
    hosts.push_back(std::make_shared<Host>(Host{order, std::move(events), {}, 0}));
    return std::make_unique<Link>(hosts.back(), identity);
  }
  std::vector<RunningHost> running(const discovery::GatewayId&) override { return found; }
  std::unique_ptr<HostLink> adopt(const RunningHost& host, HostEvents events) override {
    return launch(host.order, std::move(events));
  }

  std::vector<std::shared_ptr<Host>> hosts;  ///< loop's thread only
  std::vector<RunningHost> found;
  PluginIdentity identity;  ///< of what is launched

 private:
  struct Link final : HostLink {
    Link(std::shared_ptr<Host> of, PluginIdentity what) : host(std::move(of)), identity(std::move(what)) {}
    PluginIdentity plugin() const override { return identity; }
    void create(const InstanceSpec& spec) override { host->commands.push_back("create " + spec.order.instance); }
    void activate(const discovery::InstanceId& instance) override { host->commands.push_back("activate " + instance); }
    void deactivate(const discovery::InstanceId& instance) override {
      host->commands.push_back("deactivate " + instance);
    }
    void remove(const discovery::InstanceId& instance, Removal) override {
      host->commands.push_back("remove " + instance);
    }
    void deliver(const PassedMessage& passed) override {
      host->commands.push_back("deliver " + passed.message.driver_id);
      host->delivered = passed.number;
    }
    void answer(std::int64_t number, PassAnswer answer) override {
      constexpr const char* names[] = {"handled", "failed", "comes", "nowhere"};
      host->commands.push_back("answer " + std::to_string(number) + " " + names[static_cast<int>(answer)]);
    }
    void shutdown(std::chrono::milliseconds) override { host->commands.push_back("shutdown"); }
    std::shared_ptr<Host> host;
    const PluginIdentity identity;
  };
};

class HostFleetTest : public ::testing::Test {
 protected:
  HostFleetTest() { restart_after(1ms, 4ms); }
  ~HostFleetTest() override { loop_.stop(); }

  /// A new fleet, whose first restart comes after this time. Before anything is created.
  void restart_after(std::chrono::milliseconds first, std::chrono::milliseconds longest) {
    HostFleet::Options options;
    options.gateway = "gw"_gateway;
    options.restart = {first, longest, healthy_after, give_up_after};
    options.clock = &clock_;
    fleet_.emplace(loop_, launcher_, Placement({setting("b", "embedded", {"embedded://x"})}), options,
                   [this](const auto& status) { log_.add(status); });
  }

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
    order.instance = discovery::InstanceId(instance);
    order.plugin = plugin;
    return order;
  }
  /// A host of an earlier gateway with the instance "a".
  RunningHost running_host(const InstanceStatus& told) {
    HostedInstance hosted;
    hosted.spec.order = order("a");
    hosted.status = told;
    RunningHost running;
    running.name = "h";
    running.order = {"p.so", "gw"_gateway, false};
    running.instances = {hosted};
    return running;
  }
  static InstanceStatus status(const std::string& instance, DriverState state) {
    InstanceStatus status;
    status.instance = discovery::InstanceId(instance);
    status.driver = "p"_driver;
    status.state = state;
    return status;
  }
  static discovery::ChannelRecord channel_of(const std::string& instance) {
    discovery::ChannelRecord channel;
    channel.name = "c";
    channel.transport = "b";
    channel.broker_url = "embedded://x";
    channel.gateway = "gw"_gateway;
    channel.driver = "p"_driver;
    channel.instance = discovery::InstanceId(instance);
    channel.properties = {{"exchange", "p"}, {"routingKey", "c"}};
    return channel;
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
    on_loop([&] { launcher_.hosts.at(host)->events.on_ended({how, reason, {}}); });
  }

  static InstanceStatus failure(const std::string& instance, const std::string& reason) {
    auto told = status(instance, DriverState::failed);
    told.reason = reason;
    return told;
  }
  bool comes_to(std::size_t host, const std::vector<std::string>& wanted) {
    return tests::eventually([&] { return commands(host) == wanted; });
  }

  static constexpr int give_up_after = 6;
  static constexpr auto healthy_after = 1h;
  tests::HandClock clock_;
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

TEST_F(HostFleetTest, ADeploymentThatNamesItsNetworkHasAHostOfItsOwn) {
  auto restricted = order("a");
  restricted.properties = {{"network", ""}, {"isolation", "plugin"}};
  on_loop([&] {
    fleet_->create(order("b"));
    fleet_->create(restricted);
    fleet_->create(order("c"));
  });
  EXPECT_THAT(commands(0), ElementsAre("create b", "create c"));
  EXPECT_THAT(commands(1), ElementsAre("create a"));
  on_loop([&] {
    EXPECT_EQ(launcher_.hosts.at(0)->order.network, std::nullopt);
    EXPECT_EQ(launcher_.hosts.at(1)->order.network, "") << "nothing but the brokers";
    EXPECT_TRUE(launcher_.hosts.at(1)->order.isolated);
  });
}

TEST_F(HostFleetTest, TheLastInstanceEndsItsHostAndANewOneGetsANewHost) {
  on_loop([&] { fleet_->create(order("a")); });
  on_loop([&] { fleet_->remove("a"_instance, Removal::undeployed); });
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
  on_loop([&] { fleet_->remove("leaving"_instance, Removal::undeployed); });
  end(0, HostEnd::How::crashed, "crashed (signal 11)");
  const auto told = log_.wait_for("a", DriverState::starting);
  ASSERT_TRUE(told);
  EXPECT_THAT(told->reason, HasSubstr("crashed (signal 11); it is started again in 1 ms"));
  EXPECT_TRUE(log_.wait_for("leaving", DriverState::undeployed));
  wait_for_hosts(3);
  EXPECT_THAT(commands(2), ::testing::Contains("create a"));
  EXPECT_THAT(log_.states("other"), ElementsAre(DriverState::deployed, DriverState::active));
  EXPECT_THAT(log_.states("failed"), ElementsAre(DriverState::deployed, DriverState::failed));
  tell(2, status("a", DriverState::active));
  const auto again = log_.wait_for("a", DriverState::active);
  ASSERT_TRUE(again);
  EXPECT_EQ(again->reason, "again, after its driver host crashed (signal 11)");
}

TEST_F(HostFleetTest, AnInstanceWhoseDriverThrewIsStartedAgainEverLaterWhileTheOthersGoOn) {
  on_loop([&] {
    fleet_->create(order("a"));
    fleet_->create(order("b"));
  });
  tell(0, status("a", DriverState::active));
  tell(0, status("b", DriverState::active));
  std::vector<std::string> wanted = {"create a", "create b"};
  for (const auto* delay : {"in 1 ms", "in 2 ms", "in 4 ms", "in 4 ms"}) {
    tell(0, failure("a", "on_message: no device"));
    const auto failed = log_.wait_for("a", DriverState::failed);
    ASSERT_TRUE(failed);
    EXPECT_THAT(failed->reason, ::testing::AllOf(HasSubstr("no device; it is started again"), HasSubstr(delay)));
    EXPECT_TRUE(failed->starts_again);
    wanted.emplace_back("create a");
    ASSERT_TRUE(comes_to(0, wanted));
    tell(0, status("a", DriverState::starting));
  }
  tell(0, status("a", DriverState::active));
  const auto again = log_.wait_for("a", DriverState::active);
  ASSERT_TRUE(again);
  EXPECT_EQ(again->reason, "again, after it failed: on_message: no device");
  EXPECT_FALSE(again->starts_again);
  EXPECT_THAT(log_.states("a"), ::testing::Not(::testing::Contains(DriverState::starting)))
      << "whoever looks sees that it failed, and why, until it runs again";
  EXPECT_THAT(log_.states("b"), ElementsAre(DriverState::deployed, DriverState::active));
}

TEST_F(HostFleetTest, AnInstanceWhoseDriverThrowsTooOftenInARowIsLeftAloneAndOneThatRanLongStartsItsCountAnew) {
  on_loop([&] { fleet_->create(order("a")); });
  std::vector<std::string> wanted = {"create a"};
  for (int failures = 1; failures < give_up_after; ++failures) {
    tell(0, failure("a", "no device"));
    wanted.emplace_back("create a");
    ASSERT_TRUE(comes_to(0, wanted)) << failures;
  }
  tell(0, status("a", DriverState::active));
  clock_.advance(healthy_after);
  for (int failures = 1; failures < give_up_after; ++failures) {
    tell(0, failure("a", "no device"));
    wanted.emplace_back("create a");
    ASSERT_TRUE(comes_to(0, wanted)) << failures;
  }
  tell(0, failure("a", "no device"));
  std::optional<InstanceStatus> last;
  ASSERT_TRUE(tests::eventually([&] {
    last = log_.wait_for("a", DriverState::failed);
    return last && last->reason.find("left alone") != std::string::npos;
  }));
  EXPECT_THAT(last->reason, HasSubstr("no device; that was failure 6 in a row"));
  EXPECT_FALSE(last->starts_again);
  on_loop([&] {
    fleet_->remove("a"_instance, Removal::undeployed);
    launcher_.hosts.at(0)->events.on_status(status("a", DriverState::undeployed));
  });
  ASSERT_TRUE(log_.wait_for("a", DriverState::undeployed));
  wanted.emplace_back("remove a");
  wanted.emplace_back("shutdown");
  EXPECT_EQ(commands(0), wanted);
}

TEST_F(HostFleetTest, AnInstanceThatWaitsForItsRestartIsCreatedInItsHostsSuccessor) {
  on_loop([&] { fleet_->create(order("a")); });
  on_loop([&] {
    launcher_.hosts.at(0)->events.on_status(failure("a", "no device"));
    launcher_.hosts.at(0)->events.on_ended({HostEnd::How::crashed, "crashed", {}});
  });
  wait_for_hosts(2);
  EXPECT_TRUE(comes_to(1, {"create a"}));
}

TEST_F(HostFleetTest, AnInstanceThatWaitsForItsRestartNoLongerSaysSoWhenItsHostIsGivenUp) {
  restart_after(1h, 1h);
  on_loop([&] { fleet_->create(order("a")); });
  tell(0, failure("a", "no device"));
  ASSERT_TRUE(log_.wait_for("a", DriverState::failed).value_or(InstanceStatus{}).starts_again);
  end(0, HostEnd::How::refused, "another SDK");
  const auto given_up = log_.wait_for("a", DriverState::failed);
  ASSERT_TRUE(given_up);
  EXPECT_EQ(given_up->reason, "another SDK");
  EXPECT_FALSE(given_up->starts_again);
}

TEST_F(HostFleetTest, AnInstanceThatIsRemovedWhileItWaitsForItsRestartDoesNotComeBack) {
  restart_after(20ms, 20ms);
  on_loop([&] {
    fleet_->create(order("a"));
    fleet_->create(order("b"));
  });
  on_loop([&] {
    launcher_.hosts.at(0)->events.on_status(failure("a", "no device"));
    loop_.post([&] { fleet_->remove("a"_instance, Removal::undeployed); });  // right after the fleet has heard that
  });
  tell(0, failure("b", "no device"));
  std::vector<std::string> after_removal;  // the restart may have come before it on a busy machine, which is in order
  ASSERT_TRUE(tests::eventually([&] {
    const auto all = commands(0);
    const auto removal = std::find(all.begin(), all.end(), "remove a");
    if (removal == all.end()) return false;
    after_removal.assign(removal + 1, all.end());
    return !after_removal.empty() && after_removal.back() == "create b";
  }));
  EXPECT_THAT(after_removal, ElementsAre("create b")) << "which was due after a";
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
    fleet_->remove("a"_instance, Removal::undeployed);
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
    on_loop([&] { launcher_.hosts.at(host)->events.on_ended({HostEnd::How::crashed, "hung", "bad"_instance}); });
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
    fleet_->activate("a"_instance);
    fleet_->deactivate("a"_instance);
    fleet_->remove("a"_instance, Removal::undeployed);
  });
  EXPECT_TRUE(log_.wait_for("a", DriverState::undeployed));
  on_loop([&] { EXPECT_EQ(launcher_.hosts.size(), 1u); });
}

TEST_F(HostFleetTest, InstancesOfAHostThatRunsAlreadyAreAdopted) {
  launcher_.found = {running_host(status("a", DriverState::active))};
  on_loop([&] {
    EXPECT_EQ(fleet_->adopt().size(), 1u);
    fleet_->create(order("b"));  // joins the adopted host
    fleet_->deactivate("a"_instance);
  });
  EXPECT_THAT(commands(0), ElementsAre("create b", "deactivate a"));
}

TEST_F(HostFleetTest, AHostThatNamesAForeignBrokerIsEndedAndOthersDoNotSeeIt) {
  on_loop([&] { fleet_->create(order("a")); });
  auto told = status("a", DriverState::active);
  told.channels = {channel_of("a")};
  tell(0, told);
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  told.channels.front().broker_url = "amqp://thief:5672/";
  tell(0, told);
  EXPECT_THAT(commands(0), ElementsAre("create a", "shutdown"));
  end(0, HostEnd::How::stopped, "");
  const auto shown = log_.wait_for("a", DriverState::failed);
  ASSERT_TRUE(shown);
  EXPECT_THAT(shown->reason, HasSubstr("amqp://thief:5672/"));
  EXPECT_TRUE(shown->channels.empty());
  on_loop([&] { EXPECT_EQ(launcher_.hosts.size(), 1u) << "nobody starts it again by itself"; });
}

TEST_F(HostFleetTest, AHostThatTakesAnotherDriversNameThanItsPluginOrItsOrderHasIsEnded) {
  launcher_.identity.driver = "lamp"_driver;
  auto named = order("b", "q.so");
  named.driver = "heater"_driver;
  on_loop([&] {
    fleet_->create(order("a"));
    fleet_->create(named);
  });
  EXPECT_EQ(log_.wait_for("a", DriverState::deployed)->driver, "lamp"_driver);
  auto told = status("a", DriverState::active);
  told.driver = "lamp"_driver;
  tell(0, told);
  ASSERT_TRUE(log_.wait_for("a", DriverState::active));
  told.driver = "turtle"_driver;
  tell(0, told);
  told.instance = "b"_instance;
  tell(1, told);
  EXPECT_THAT(commands(0), ElementsAre("create a", "shutdown"));
  EXPECT_THAT(commands(1), ElementsAre("create b", "shutdown"));
}

TEST_F(HostFleetTest, AHostThatHasTakenAnotherDriversNameIsNotAdopted) {
  auto told = status("a", DriverState::active);
  told.driver = "turtle"_driver;
  launcher_.found = {running_host(told)};
  launcher_.found.front().order.identity.driver = "lamp"_driver;
  on_loop([&] { EXPECT_TRUE(fleet_->adopt().empty()); });
  EXPECT_THAT(commands(0), ElementsAre("shutdown"));
}

TEST_F(HostFleetTest, AHostWhoseAddressesAreNoLongerInTheConfigurationIsNotAdopted) {
  auto told = status("a", DriverState::active);
  told.channels = {channel_of("a")};
  told.channels.front().properties["urls"] = "embedded://x embedded://before";
  launcher_.found = {running_host(told)};
  on_loop([&] {
    EXPECT_TRUE(fleet_->adopt().empty());
    fleet_->create(order("a"));
  });
  EXPECT_THAT(commands(0), ElementsAre("shutdown"));
  EXPECT_THAT(commands(1), ElementsAre("create a"));
}

TEST_F(HostFleetTest, AReportIsTrueOnlyWithTheInstancesOwnNamesBrokersAndTopics) {
  const std::vector<brokers::BrokerSetting> known{setting("b", "embedded", {"embedded://x", "embedded://y"})};
  const auto judge = [&](const std::function<void(InstanceStatus&)>& lie) {
    auto told = status("a", DriverState::active);
    told.channels = {channel_of("a")};
    lie(told);
    return contradiction(told, order("a"), "p"_driver, "gw"_gateway, known);
  };
  using discovery::ChannelRecord;
  const auto channel = [&](const std::function<void(ChannelRecord&)>& lie) {
    return judge([&](InstanceStatus& told) { lie(told.channels.front()); });
  };
  EXPECT_EQ(judge([](auto&) {}), "");
  EXPECT_EQ(channel([](auto& c) { c.properties["urls"] = "embedded://y embedded://x"; }), "");
  EXPECT_EQ(channel([](auto& c) { c.shared = true; }), "");
  EXPECT_THAT(channel([](auto& c) { c.properties["urls"] = "embedded://y amqp://u:secret@thief"; }),
              AllOf(HasSubstr("thief"), Not(HasSubstr("secret"))));
  EXPECT_THAT(channel([](auto& c) { c.transport = "other"; }), HasSubstr("\"other\""));
  EXPECT_THAT(channel([](auto& c) { c.gateway = "gw2"_gateway; }), HasSubstr("gw2"));
  EXPECT_THAT(channel([](auto& c) { c.instance = "other"_instance; }), HasSubstr("other"));
  EXPECT_THAT(channel([](auto& c) { c.driver = "lamp"_driver; }), HasSubstr("lamp"));
  EXPECT_NE(channel([](auto& c) { c.name = "../other"; }), "");
  EXPECT_NE(judge([](auto& told) { told.driver = discovery::DriverName("../lamp"); }), "");
  for (const char* topic : {"gw.lamp.a.c", "gw.p.other.c", "gw2.p.a.c"}) {
    auto record = channel_of("a");
    record.properties = {{"routingKey", topic}, {"queueName", topic}, {"durable", "false"}};
    EXPECT_THAT(discovery::wire_name(record), StartsWith("gw.p.a.")) << "readers never leave the instance's own topics";
  }
  EXPECT_THAT(judge([](auto& told) { told.driver = "turtle"_driver; }), HasSubstr("it says that it is turtle a"));
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
  EXPECT_EQ(done.get_future().wait_for(tests::patience), std::future_status::ready);
  EXPECT_TRUE(log_.wait_for("a", DriverState::undeployed));
  EXPECT_TRUE(log_.wait_for("b", DriverState::undeployed));
}

TEST_F(HostFleetTest, WhoeverShutsItDownHearsOfTheEnd) {
  std::vector<int> heard;
  std::promise<void> done;
  on_loop([&] {
    fleet_->create(order("a"));
    fleet_->shutdown(1s, [&] { heard.push_back(1); });
    fleet_->shutdown(1s, [&] {
      heard.push_back(2);
      done.set_value();
    });
  });
  end(0, HostEnd::How::stopped, "");
  ASSERT_EQ(done.get_future().wait_for(tests::patience), std::future_status::ready);
  EXPECT_THAT(heard, ElementsAre(1, 2));
}

TEST(Placement, GroupsOfBothKindsTakeTurnsOverTheServers) {
  Placement placement({setting("r", "rabbitmq", {"u1", "u2"})});
  const auto first = placement.place("turtle"_driver).at(0);
  const auto second = placement.place("turtle"_driver).at(0);
  const auto third = placement.place("lamp"_driver).at(0);
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
  placement.learn("turtle"_driver, {{"r", "rabbitmq", {}, {"u1", "u2"}, {"u2", "u1"}}});
  EXPECT_EQ(placement.place("turtle"_driver).at(0).shared_urls.front(), "u2");
}

/// Two hosts, the first with "a", the second with "b".
class PassedMessages : public HostFleetTest {
 protected:
  void start(const std::string& second_driver) {
    on_loop([&] {
      for (const auto& [instance, plugin, driver] :
           {std::tuple{"a", "p.so", std::string("p")}, std::tuple{"b", "q.so", second_driver}}) {
        auto made = order(instance, plugin);
        made.driver = discovery::DriverName(driver);
        fleet_->create(made);
      }
    });
  }
  /// The first host passes a message for this instance. \return what the first host is told then
  std::string pass(const std::string& instance) {
    PassedMessage passed;
    passed.number = 7;
    passed.topic = "gw.p.control";
    passed.message.driver_id = instance;
    on_loop([&] { launcher_.hosts.at(0)->events.on_pass(passed); });
    return commands(0).back();
  }
  void answer(PassAnswer answer) {
    on_loop([&] {
      const auto& second = *launcher_.hosts.at(1);
      second.events.on_answer(second.delivered, answer);
    });
  }
};

TEST_F(PassedMessages, GoToTheHostThatRunsTheirInstanceAndTheAnswerComesBack) {
  start("p");
  EXPECT_EQ(pass("b"), "create a") << "no answer yet";
  EXPECT_EQ(commands(1).back(), "deliver b");
  answer(PassAnswer::handled);
  EXPECT_EQ(commands(0).back(), "answer 7 handled");
  EXPECT_EQ(pass("b"), "answer 7 handled");
  answer(PassAnswer::failed);
  EXPECT_EQ(commands(0).back(), "answer 7 failed");
}

TEST_F(PassedMessages, ForAnInstanceThatNoHostRunsAreAnsweredSo) {
  start("p");
  EXPECT_EQ(pass("c"), "answer 7 nowhere");
}

TEST_F(PassedMessages, DoNotReachAnotherDriver) {
  start("q");
  EXPECT_EQ(pass("b"), "answer 7 nowhere");
  EXPECT_EQ(commands(1).back(), "create b");
}

TEST_F(PassedMessages, WaitForAnInstanceWhoseHostIsStartedAgain) {
  start("p");
  EXPECT_EQ(pass("b"), "create a");
  end(1, HostEnd::How::crashed, "died");
  EXPECT_EQ(commands(0).back(), "answer 7 comes");
  wait_for_hosts(3);
}

TEST_F(PassedMessages, WaitForAnInstanceWhoseDriverIsStartedAgainUntilItRuns) {
  restart_after(20ms, 20ms);
  start("p");
  tell(1, status("b", DriverState::active));
  tell(1, failure("b", "no device"));
  ASSERT_TRUE(log_.wait_for("b", DriverState::failed));
  EXPECT_EQ(pass("b"), "answer 7 comes") << "its restart is planned";
  ASSERT_TRUE(comes_to(1, {"create b", "create b"}));
  tell(1, status("b", DriverState::starting));
  EXPECT_EQ(pass("b"), "answer 7 comes") << "it opens";
  EXPECT_EQ(commands(1).back(), "create b");
  tell(1, status("b", DriverState::active));
  pass("b");
  EXPECT_EQ(commands(1).back(), "deliver b");
}

TEST_F(PassedMessages, GoToAHostWhoseInstanceIsStillOpeningForTheFirstTime) {
  start("p");
  tell(1, status("b", DriverState::starting));
  EXPECT_EQ(pass("b"), "create a") << "the host answers for it";
  EXPECT_EQ(commands(1).back(), "deliver b");
}

TEST_F(PassedMessages, DoNotWaitForAnInstanceThatIsLeftAlone) {
  start("p");
  for (int failures = 0; failures < give_up_after; ++failures) {
    std::vector<std::string> created(static_cast<std::size_t>(failures) + 1, "create b");
    ASSERT_TRUE(comes_to(1, created));
    tell(1, failure("b", "no device"));
  }
  ASSERT_TRUE(tests::eventually([&] {
    const auto failed = log_.wait_for("b", DriverState::failed);
    return failed && failed->reason.find("left alone") != std::string::npos;
  }));
  EXPECT_EQ(pass("b"), "answer 7 nowhere");
}

TEST_F(PassedMessages, AreNotAnsweredToTheHostsNextLifeWhichNumbersItsOwnFromTheStart) {
  start("p");
  pass("b");
  end(0, HostEnd::How::crashed, "died");
  wait_for_hosts(3);
  answer(PassAnswer::handled);
  EXPECT_EQ(commands(2), std::vector<std::string>{"create a"});
}

}  // namespace
}  // namespace iotcloud::gateway
