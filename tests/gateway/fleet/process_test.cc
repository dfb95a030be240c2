// Driver hosts as real processes.
#include <algorithm>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <future>
#include <thread>

#include <nlohmann/json.hpp>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/config/log_settings.h>
#include <iotcloud/drivers/plugin.h>
#include <iotcloud/gateway/fleet/host_proofs.h>
#include <iotcloud/gateway/fleet/process_link.h>
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

TEST_F(ProcessTest, AnInstanceRunsInAProcessOfItsPluginAndTheLastOneEndsIt) {
  start_gateway();
  give(quiet("a"));
  give(quiet("b"));
  ASSERT_TRUE(comes_to("a", DriverState::active) && comes_to("b", DriverState::active));
  const int process = host_process();
  ASSERT_GT(process, 0);
  EXPECT_NE(process, getpid());
  EXPECT_NE(getsid(process), getsid(0)) << "it does not get the terminal's signals";
  take_back("a");
  EXPECT_TRUE(eventually([&] { return !record("a"); }));
  EXPECT_EQ(host_process(), process);
  take_back("b");
  EXPECT_TRUE(has_ended(process));
  EXPECT_TRUE(eventually([&] { return sockets().empty(); }));
}

TEST_F(ProcessTest, WhatADriverSaysOfItselfComesThroughItsProcess) {
  start_gateway();
  give(quiet("a", "probe.so", {{"says", "battery=90"}}));
  EXPECT_TRUE(eventually([&] {
    const auto now = record("a");
    return now && now->state == DriverState::active && now->metadata.contains("battery");
  }));
}

TEST_F(ProcessTest, ACrashIsToldAndTheInstancesRunAgainWhileOtherPluginsNoticeNothing) {
  start_gateway();
  const std::string crash_file = folder_ / "crash";
  give(quiet("a", "probe.so", {{"crash_file", crash_file}}));
  give(quiet("b", "other.so"));
  ASSERT_TRUE(comes_to("a", DriverState::active) && comes_to("b", DriverState::active, "other"));
  const auto untouched = record("b", "other");

  StatusLog told;
  const auto watch = registry_->watch_node(paths_.instance("probe"_driver, "a"_instance), [&](const auto& node) {
    if (!node) return;
    const auto record = discovery::decode_driver(node->data, "a");
    told.add(
        {"a"_instance, record.name, record.state, record.reason, record.since_ms, record.channels, record.metadata});
  });
  ASSERT_TRUE(told.wait_for("a", DriverState::active));
  tests::write_file(crash_file, "");
  EXPECT_TRUE(eventually([&] { return !fs::exists(crash_file); }));
  EXPECT_TRUE(told.wait_for("a", DriverState::active));
  EXPECT_EQ(record("b", "other"), untouched);
}

TEST_F(ProcessTest, WhatAHostHadSpooledWhenItCrashedIsThereForTheNext) {
  start_gateway();
  const std::string crash_file = folder_ / "crash";
  give(order("a", {{"channel.readings.when_full", "spool"}, {"crash_file", crash_file}}));
  const auto segments = [&] {
    std::size_t count = 0;
    std::error_code error;
    for (const auto& file : fs::directory_iterator(state_ / "spool/a/readings", error)) {
      count += file.path().extension() == ".segment" && fs::file_size(file.path(), error) > 50 ? 1 : 0;
    }
    return count;
  };
  // Nobody reads what the driver says when it is activated.
  ASSERT_TRUE(eventually([&] { return segments() == 1; }));
  tests::write_file(crash_file, "");
  EXPECT_TRUE(eventually([&] { return segments() == 2; })) << "one of each run";
  take_back("a");
  EXPECT_TRUE(eventually([&] { return !record("a"); }));
  EXPECT_EQ(segments(), 2u) << "an undeployed instance's messages are not thrown away";
}

TEST_F(ProcessTest, AHostThatCrashesAtOnceAgainIsToldWithItsSignal) {
  auto slow = options();
  slow.restart.first = 1h;  // the state stays to be seen
  gateway_.emplace(std::move(slow));
  gateway_->start();
  const std::string crash_file = folder_ / "crash";
  give(quiet("a", "probe.so", {{"crash_file", crash_file}}));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  tests::write_file(crash_file, "");
  ASSERT_TRUE(comes_to("a", DriverState::starting));
  EXPECT_THAT(record("a")->reason, AllOf(HasSubstr("signal 11"), HasSubstr("started again in 3600000 ms")));
  take_back("a");
  EXPECT_TRUE(eventually([&] { return !record("a"); }));
}

TEST_F(ProcessTest, AHostThatCannotBeStartedForNowIsTriedAgain) {
  auto patient = options();
  patient.restart.longest = 50ms;
  patient.restart.give_up_after = 0;  // never
  gateway_.emplace(std::move(patient));
  gateway_->start();
  const fs::path log = state_ / "logs/probe.log";
  fs::create_directory(log);  // as if there were no room for it
  give(quiet("a"));
  ASSERT_TRUE(comes_to("a", DriverState::starting));
  EXPECT_TRUE(
      eventually([&] { return record("a")->reason.find("could not be started: the log") != std::string::npos; }));
  fs::remove(log);
  EXPECT_TRUE(comes_to("a", DriverState::active));
}

TEST_F(ProcessTest, WhatWaitsForItsRestartSaysSoWhetherItsDriverThrewOrItsHostDied) {
  auto slow = options();
  slow.restart.first = 1h;  // the states stay to be seen
  gateway_.emplace(std::move(slow));
  gateway_->start();
  give(quiet("threw", "probe.so", {{"throw_in", "open"}}));
  give(quiet("well"));
  ASSERT_TRUE(comes_to("threw", DriverState::failed) && comes_to("well", DriverState::active));
  EXPECT_TRUE(record("threw")->starts_again);
  EXPECT_FALSE(record("well")->starts_again);
  const int process = host_process();
  ASSERT_GT(process, 0);
  kill(process, SIGKILL);
  ASSERT_TRUE(comes_to("well", DriverState::starting));
  EXPECT_EQ(record("threw")->state, DriverState::failed);
  EXPECT_TRUE(record("threw")->starts_again) << "in its host's successor";
}

TEST_F(ProcessTest, AHostThatHangsIsKilledAndStartedAgain) {
  hang_limit_ = 4s;  // in which a busy machine starts it
  start_gateway();
  give(quiet("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  const int process = host_process();
  ASSERT_GT(process, 0);
  kill(process, SIGSTOP);
  EXPECT_TRUE(has_ended(process));
  EXPECT_TRUE(eventually([&] { return host_process() > 0 && host_process() != process; }));
  EXPECT_TRUE(comes_to("a", DriverState::active));
}

TEST_F(ProcessTest, WhatAHostCountsIsInTheGatewaysMetricsUntilTheHostEnds) {
  const auto has = [&](const std::string& metric, const std::string& host) {
    std::vector<config::Sample> samples;
    metrics_->append(samples);
    return std::any_of(samples.begin(), samples.end(), [&](const config::Sample& sample) {
      return sample.name == metric && sample.labels.at("host") == host;
    });
  };
  start_gateway();
  give(order("a"));  // it says "up", and nobody reads it
  give(quiet("b", "other.so", {{"isolation", "instance"}}));
  EXPECT_TRUE(eventually([&] { return has("iotcloud_host_memory_bytes", "probe"); }));
  EXPECT_TRUE(eventually([&] { return has("iotcloud_host_memory_bytes", "other#b"); }));
  EXPECT_TRUE(eventually([&] { return has("iotcloud_driver_messages_total", "probe"); }));
  take_back("a");
  EXPECT_TRUE(eventually([&] { return !has("iotcloud_host_memory_bytes", "probe"); }));
  EXPECT_TRUE(has("iotcloud_host_memory_bytes", "other#b"));
}

TEST_F(ProcessTest, APluginThatAsksForItHasAHostForEachInstanceUnlessItsOrderSaysOtherwise) {
  fs::copy(plugins_ / "probe.so", plugins_ / "alone.so");
  std::ofstream(plugins_ / "alone.so", std::ios::binary | std::ios::app) << IOTCLOUD_DRIVER_ISOLATION_MARK;
  start_gateway();
  const auto hosts_with = [&](const std::string& instance, const std::map<std::string, std::string>& properties) {
    give(quiet(instance, "alone.so", properties));
    EXPECT_TRUE(comes_to(instance, DriverState::active, "alone"));
    return sockets().size();
  };
  EXPECT_EQ(hosts_with("a", {}), 1);
  EXPECT_EQ(hosts_with("b", {}), 2);
  EXPECT_EQ(hosts_with("c", {{"isolation", "plugin"}}), 3);
  EXPECT_EQ(hosts_with("d", {{"isolation", "plugin"}}), 3);
}

TEST_F(ProcessTest, APluginOfAnotherSdkIsRefusedInItsRecordNamingBothSides) {
  start_gateway();
  give(quiet("a", "future_sdk.so"));
  give(quiet("b"));
  ASSERT_TRUE(comes_to("a", DriverState::failed, "future_sdk"));
  EXPECT_THAT(
      record("a", "future_sdk")->reason,
      AllOf(HasSubstr("4711"), HasSubstr("this driver host has version " + std::to_string(drivers::sdk_version))));
  EXPECT_TRUE(comes_to("b", DriverState::active));
}

TEST_F(ProcessTest, AHostCannotTakeAnotherDriversNameThanItsPluginsBytesHave) {
  fs::copy(fs::path(TEST_PLUGINS) / "liar.so", plugins_ / "liar.so");
  start_gateway();
  auto wanted = quiet("a", "liar.so");
  wanted.driver = discovery::DriverName();
  give(wanted);
  ASSERT_TRUE(comes_to("a", DriverState::failed, "liar"));
  EXPECT_THAT(record("a", "liar")->reason, HasSubstr("it says that it is turtle a"));
  EXPECT_FALSE(record("a", "turtle"));
}

TEST_F(ProcessTest, WhatEverybodyMayWriteIsNotRun) {
  using enum fs::perms;
  start_gateway();
  fs::permissions(plugins_, all);
  give(quiet("a"));
  ASSERT_TRUE(comes_to("a", DriverState::failed, "probe"));
  EXPECT_THAT(record("a", "probe")->reason, HasSubstr("chmod o-w " + plugins_.string()));
  EXPECT_THROW(new_launcher(), config::Error);

  fs::permissions(plugins_, others_write, fs::perm_options::remove);
  fs::permissions(plugins_ / "other.so", others_write, fs::perm_options::add);
  give(quiet("b", "other.so"));
  ASSERT_TRUE(comes_to("b", DriverState::failed, "other"));
  EXPECT_THAT(record("b", "other")->reason, HasSubstr("chmod o-w " + (plugins_ / "other.so").string()));
  EXPECT_TRUE(sockets().empty());
}

TEST_F(ProcessTest, StoppingTheGatewayEndsItsHosts) {
  start_gateway();
  give(quiet("a"));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  const int process = host_process();
  gateway_->stop(20s);
  EXPECT_EQ(record("a")->state, DriverState::inactive);
  EXPECT_TRUE(has_ended(process));
}

TEST_F(ProcessTest, AHostOutlivesItsLinkAndIsAdoptedWithItsInstances) {
  StatusLog first_life, second_life;
  std::optional<HostEnd> end;
  std::mutex mutex;
  {
    const auto launcher = new_launcher();
    auto link = launcher->launch({"probe.so", "gw"_gateway, false},
                                 {[&](const auto& s) { first_life.add(s); }, [](const auto&) {}});
    InstanceSpec spec;
    spec.order = quiet("a");
    spec.brokers = {{"local", "embedded", {}, {"embedded://x"}, {"embedded://x"}}};
    link->create(spec);
    ASSERT_TRUE(first_life.wait_for("a", DriverState::active));
  }
  const int process = host_process();
  ASSERT_GT(process, 0) << "it did not outlive its link";

  const auto launcher = new_launcher();
  const auto running = launcher->running("gw"_gateway);
  ASSERT_EQ(running.size(), 1u);
  ASSERT_EQ(running[0].instances.size(), 1u);
  EXPECT_EQ(running[0].order.plugin, "probe.so");
  EXPECT_EQ(running[0].instances[0].status.state, DriverState::active);
  EXPECT_EQ(running[0].instances[0].spec.order, quiet("a"));
  auto link = launcher->adopt(running[0], {[&](const auto& s) { second_life.add(s); },
                                           [&](const HostEnd& e) {
                                             const std::lock_guard lock(mutex);
                                             end = e;
                                           }});
  EXPECT_TRUE(second_life.wait_for("a", DriverState::active));
  link->deactivate("a"_instance);
  EXPECT_TRUE(second_life.wait_for("a", DriverState::inactive));
  EXPECT_EQ(host_process(), process);
  link->shutdown(20s);
  EXPECT_TRUE(second_life.wait_for("a", DriverState::undeployed));
  EXPECT_TRUE(eventually([&] {
    const std::lock_guard lock(mutex);
    return end.has_value();
  }));
  EXPECT_EQ(end->how, HostEnd::How::stopped);
}

TEST_F(ProcessTest, AHostStopsAnInstanceWhoseLeaseNobodyRenewsAlsoWithoutAGateway) {
  // Renews the lease until the instance has become active, for the given time in all.
  const auto renew = [](HostLink& link, const StatusLog& log, std::ptrdiff_t times) {
    return eventually([&] {
      link.renew(config::system_clock().now());
      const auto states = log.states("a");
      return std::count(states.begin(), states.end(), DriverState::active) >= times;
    });
  };
  StatusLog first_life, second_life;
  {
    const auto launcher = new_launcher();
    auto link = launcher->launch({"probe.so", "gw"_gateway, false},
                                 {[&](const auto& s) { first_life.add(s); }, [](const auto&) {}});
    InstanceSpec spec;
    spec.order = quiet("a", "probe.so", {{"on_partition", "stop"}, {"lease", "1s"}});
    spec.brokers = {{"local", "embedded", {}, {"embedded://x"}, {"embedded://x"}}};
    link->create(spec);
    const auto waits = first_life.wait_for("a", DriverState::inactive);
    ASSERT_TRUE(waits);
    EXPECT_THAT(waits->reason, HasSubstr("not started: its gateway has no lease"));
    ASSERT_TRUE(renew(*link, first_life, 1));
    const auto stopped = first_life.wait_for("a", DriverState::inactive);
    ASSERT_TRUE(stopped);
    EXPECT_THAT(stopped->reason, HasSubstr("stopped: no lease since"));
    ASSERT_TRUE(renew(*link, first_life, 2));
  }
  const auto launcher = new_launcher();
  EXPECT_TRUE(eventually([&] {
    const auto running = launcher->running("gw"_gateway);
    return running.size() == 1 && running[0].instances.at(0).status.state == DriverState::inactive;
  }));
  const auto running = launcher->running("gw"_gateway);
  ASSERT_EQ(running.size(), 1U);
  auto link = launcher->adopt(running[0], {[&](const auto& s) { second_life.add(s); }, [](const auto&) {}});
  EXPECT_TRUE(renew(*link, second_life, 1));
  link->shutdown(20s);
  EXPECT_TRUE(second_life.wait_for("a", DriverState::undeployed));
}

TEST_F(ProcessTest, AHostThatStandsStillForLessThanTheHangLimitIsAdoptedAndNotKilled) {
  const int process = host_without_gateway();
  ASSERT_GT(process, 0);
  kill(process, SIGSTOP);
  const auto launcher = new_launcher();
  auto running = std::async(std::launch::async, [&] { return launcher->running("gw"_gateway); });
  EXPECT_EQ(running.wait_for(2500ms), std::future_status::timeout) << "it is given up, far within the limit of 20 s";
  kill(process, SIGCONT);
  EXPECT_EQ(running.get().size(), 1u);
  EXPECT_EQ(host_process(), process);
}

TEST_F(ProcessTest, AGatewaysLastCommandsDoNotKeepAHostFromTheNextGateway) {
  const int process = host_without_gateway();
  ASSERT_GT(process, 0);
  const std::string socket = sockets().at(0);
  const auto hears = [](const processes::OwnedDescriptor& connection) {
    return processes::wait_readable(connection.get(), tests::patience) &&
           processes::receive_some(connection).has_value();
  };
  // While the host stands still, one gateway sends a command and ends, and the next one connects: the host finds all
  // of it at once.
  auto first = processes::connect_in(state_, socket);
  const std::string proof = encode(protocol::ProveGateway{HostProofs(state_).of(socket)});
  ASSERT_TRUE(first && processes::send_all(first, proof) && hears(first));
  kill(process, SIGSTOP);
  ASSERT_TRUE(processes::send_all(first, encode(protocol::Ping{})));
  first.reset();
  const auto second = processes::connect_in(state_, socket);
  ASSERT_TRUE(second && processes::send_all(second, proof));
  kill(process, SIGCONT);
  EXPECT_TRUE(hears(second));
}

/// A process that can reach a host's socket, such as another host of the same user, but is not the host's gateway.
class StrangerAtAHostsSocket : public ProcessTest {
 protected:
  StrangerAtAHostsSocket() : process_(host_without_gateway()), socket_(sockets().at(0)) {}
  /// Connects and says this. \return whether the host answered; false: it closed the connection
  bool is_answered(const std::string& said) const {
    const auto connection = processes::connect_in(state_, socket_);
    if (!connection || !processes::send_all(connection, said)) return false;
    if (!processes::wait_readable(connection.get(), tests::patience)) {
      ADD_FAILURE() << "the host neither answers nor closes the connection";
      return false;
    }
    return processes::receive_some(connection).has_value();
  }
  static std::string shutdown() { return encode(protocol::ShutDown{1ms}); }
  const int process_;
  const std::string socket_;
};

TEST_F(StrangerAtAHostsSocket, IsCutOffAndChangesNothing) {
  ASSERT_GT(process_, 0);
  const HostProofs another(plugins_);
  for (const auto& said : {shutdown(), encode(protocol::ProveGateway{""}) + shutdown(),
                           encode(protocol::ProveGateway{HostProofs(state_).of("another.sock")}) + shutdown(),
                           encode(protocol::ProveGateway{HostProofs(state_).check_of(socket_)}) + shutdown(),
                           encode(protocol::ProveGateway{another.of(socket_)}) + shutdown(), std::string(8000, '\0'),
                           std::string("\x00\x10\x00\x00", 4) + std::string(8000, 'x')}) {
    EXPECT_FALSE(is_answered(said)) << said.substr(0, 200);
  }
  const auto running = new_launcher()->running("gw"_gateway);
  ASSERT_EQ(running.size(), 1u);
  ASSERT_EQ(running.front().instances.size(), 1u);
  EXPECT_EQ(running.front().instances.front().status.state, DriverState::active);
  EXPECT_EQ(host_process(), process_);
}

TEST_F(StrangerAtAHostsSocket, DoesNotKeepTheGatewayOutBySayingNothing) {
  ASSERT_GT(process_, 0);
  std::vector<processes::OwnedDescriptor> silent;
  for (int i = 0; i < 40; ++i) {
    silent.push_back(processes::connect_in(state_, socket_));
    ASSERT_TRUE(silent.back());
  }
  StatusLog log;
  const auto launcher = new_launcher();
  const auto running = launcher->running("gw"_gateway);
  ASSERT_EQ(running.size(), 1u);
  const auto link = launcher->adopt(running[0], {[&](const auto& s) { log.add(s); }, [](const auto&) {}});
  link->deactivate("a"_instance);
  EXPECT_TRUE(log.wait_for("a", DriverState::inactive));
}

TEST_F(StrangerAtAHostsSocket, OfAnotherUserIsCutOffEvenWithTheProof) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can act as another user";
  ASSERT_GT(process_, 0);
  const std::string said = encode(protocol::ProveGateway{HostProofs(state_).of(socket_)}) + shutdown();
  for (const auto& folder : {folder_, state_}) chmod(folder.c_str(), 0777);
  chmod((state_ / socket_).c_str(), 0777);
  std::thread([&] {
    constexpr long nobody = 65534;
    ASSERT_EQ(syscall(SYS_setresuid, -1L, nobody, -1L), 0);  // unlike seteuid(), for this thread alone
    EXPECT_FALSE(is_answered(said));
  }).join();
  EXPECT_EQ(new_launcher()->running("gw"_gateway).size(), 1u);
}

TEST_F(ProcessTest, AHostLogsAsItsGatewayDoesWhenItStartsIt) {
  const auto before = config::log_level();
  config::set_log_format(config::LogFormat::json);
  config::set_log_level(config::LogLevel::debug);
  start_gateway();
  give(quiet("a", "probe.so", {{"says", "battery=90"}}));
  EXPECT_TRUE(comes_to("a", DriverState::active));
  take_back("a");
  EXPECT_TRUE(eventually([&] { return sockets().empty(); }));
  config::set_log_format(config::LogFormat::text);
  config::set_log_level(before);
  std::ifstream file(state_ / "logs/probe.log");
  std::string line;
  std::size_t lines = 0;
  for (; std::getline(file, line); ++lines) EXPECT_TRUE(nlohmann::json::parse(line).contains("text")) << line;
  EXPECT_GT(lines, 0u);
}

TEST_F(ProcessTest, AGatewayThatStoodStillDoesNotTakeItsHostsForHung) {
  StatusLog after;
  const int process = host_without_gateway();
  ASSERT_GT(process, 0);
  ProcessLauncher::Options options;
  options.state_dir = state_;
  options.ping_period = 20ms;
  options.hang_limit = 3s;
  std::atomic<int> pings{0};
  std::atomic<bool> ended{false};
  const auto stand_still_once = [&] {
    if (pings++ == 0) std::this_thread::sleep_for(options.hang_limit + 100ms);
  };
  ProcessLink link(options, {"probe.so", "gw"_gateway, false}, sockets().front(),
                   HostProofs(state_).of(sockets().front()), {process, false},
                   {[&](const auto& s) { after.add(s); }, [&](const auto&) { ended = true; }}, stand_still_once,
                   nullptr);
  ASSERT_TRUE(eventually([&] { return pings > 1 || ended; }));
  EXPECT_FALSE(ended);
  link.deactivate("a"_instance);
  EXPECT_TRUE(after.wait_for("a", DriverState::inactive));
}

TEST_F(ProcessTest, AProcessThatHasAHostsIdOrSocketButIsNotThatHostIsNotKilled) {
  hang_limit_ = 100ms;
  const processes::OwnedDescriptor socket = processes::listen_in(state_, "abc.sock");
  int up[2], end[2];
  ASSERT_EQ(pipe(up), 0);
  ASSERT_EQ(pipe(end), 0);
  constexpr int unharmed = 7;
  const pid_t other = fork();
  if (other == 0) {
    listen(socket.get(), 1);  // from now on the socket's peer is this process
    char byte = 0;
    if (write(up[1], &byte, 1) != 1 || read(end[0], &byte, 1) != 1) _exit(1);
    _exit(unharmed);
  }
  char byte = 0;
  ASSERT_EQ(read(up[0], &byte, 1), 1);
  EXPECT_TRUE(new_launcher()->running("gw"_gateway).empty());
  EXPECT_EQ(write(end[1], &byte, 1), 1);
  int status = 0;
  EXPECT_EQ(waitpid(other, &status, 0), other);
  EXPECT_TRUE(WIFEXITED(status)) << "it was killed";
  EXPECT_EQ(WEXITSTATUS(status), unharmed);
  EXPECT_TRUE(sockets().empty());
  for (const int descriptor : {up[0], up[1], end[0], end[1]}) close(descriptor);
}

TEST_F(ProcessTest, TheHostOfAnotherGatewayInTheFolderIsEnded) {
  StatusLog log;
  {
    const auto launcher = new_launcher();
    auto link = launcher->launch({"probe.so", "another"_gateway, false},
                                 {[&](const auto& s) { log.add(s); }, [](const auto&) {}});
    InstanceSpec spec;
    spec.order = quiet("a");
    spec.brokers = {{"local", "embedded", {}, {"embedded://x"}, {"embedded://x"}}};
    link->create(spec);
    ASSERT_TRUE(log.wait_for("a", DriverState::active));
  }
  EXPECT_TRUE(new_launcher()->running("gw"_gateway).empty());
  EXPECT_TRUE(sockets().empty());
}

}  // namespace
}  // namespace iotcloud::gateway
