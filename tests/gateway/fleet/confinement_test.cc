// What driver hosts give up, as drivers in real processes see it.
#include <array>
#include <atomic>
#include <map>
#include <memory>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/config/file_stamp.h>
#include <iotcloud/processes/landlock.h>
#include <iotcloud/tests/captured_log.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/fleet/process_fixture.h>
#include <iotcloud/tests/gateway/status_log.h>
#include <iotcloud/tests/loopback_listener.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Pair;
namespace fs = std::filesystem;

class ConfinedHosts : public ProcessTest {
 protected:
  ConfinedHosts() { fs::copy(fs::path(TEST_PLUGINS) / "confined.so", plugins_ / "confined.so"); }

  /// What a driver in such a host finds out.
  std::map<std::string, std::string> facts(std::map<std::string, std::string> properties = {}) {
    start_gateway();
    return facts_here(std::move(properties));
  }
  /// The same, at the gateway that runs.
  std::map<std::string, std::string> facts_here(std::map<std::string, std::string> properties,
                                                const std::string& instance = "a") {
    give(quiet(instance, "confined.so", std::move(properties)));
    EXPECT_TRUE(comes_to(instance, DriverState::active, "confined"));
    EXPECT_TRUE(eventually([&] {
      const auto now = record(instance, "confined");
      return now && now->metadata.contains("user");
    }));
    const auto now = record(instance, "confined");
    return now ? now->metadata : std::map<std::string, std::string>{};
  }
  /// The copy that hosts get of the only file in broker_files_.
  fs::path only_broker_file() const {
    std::vector<fs::path> copies;
    for (const auto& entry : fs::directory_iterator(state_ / "broker-files")) copies.push_back(entry.path());
    EXPECT_EQ(copies.size(), 1u);
    return copies.empty() ? fs::path() : copies.front();
  }
};

TEST_F(ConfinedHosts, WithoutAConfinementADriverMayWhatItsGatewayMay) {
  auto found = facts();
  EXPECT_EQ(found["user"], std::to_string(geteuid()));
  EXPECT_EQ(found["no_new_privileges"], "0");
  EXPECT_EQ(found["unshare"], "ok");
  EXPECT_EQ(found["clone3"], "EINVAL") << "the kernel looks at the call";
  EXPECT_EQ(found["process_vm_readv"], "ok");
  if (geteuid() == 0) {
    EXPECT_EQ(found["name_spaces"], "user mount pid net ipc uts cgroup");
  }
}

TEST_F(ConfinedHosts, GiveUpNewPrivilegesCoreDumpsDebuggersAndFiles) {
  confinement_.no_new_privileges = true;
  confinement_.debuggable = false;
  confinement_.open_files = 200;
  auto found = facts();
  EXPECT_EQ(found["no_new_privileges"], "1");
  EXPECT_EQ(found["dumpable"], "0");
  EXPECT_EQ(found["core"], "0");
  EXPECT_EQ(found["open_files"], "200");
}

TEST_F(ConfinedHosts, AreRefusedSystemCallsThatNoDriverNeedsAndMayStartThreadsAndPrograms) {
  confinement_.no_new_privileges = true;  // what the kernel wants of a filter that root did not set
  auto attack = facts();
  if (geteuid() == 0) {
    EXPECT_THAT(attack["name_spaces"], HasSubstr("uts")) << "without a filter";
    EXPECT_NE(attack["clone3"], "ENOSYS");
  }
  take_back("a");
  gateway_.reset();
  confinement_.filter_calls = true;
  auto found = facts();
  EXPECT_EQ(found["unshare"], "EPERM");
  EXPECT_EQ(found["name_spaces"], "") << "by clone()";
  EXPECT_EQ(found["clone3"], "ENOSYS") << "whose flags no filter sees";
  EXPECT_EQ(found["ptrace"], "EPERM");
  EXPECT_EQ(found["process_vm_readv"], "EPERM");
  EXPECT_EQ(found["thread"], "ok");
  EXPECT_EQ(found["program"], "ok");
}

TEST_F(ConfinedHosts, CannotGetAroundTheFilterByARing) {
  confinement_.no_new_privileges = true;
  EXPECT_EQ(facts()["io_uring"], "EFAULT") << "without a filter the kernel looks at the call";
  gateway_.reset();
  confinement_.filter_calls = true;
  EXPECT_EQ(facts()["io_uring"], "EPERM");
}

TEST_F(ConfinedHosts, DoNotSeeTheSecretsInTheirGatewaysEnvironment) {
  setenv("IOTCLOUD_TEST_SECRET", "sesame", 1);
  const std::map<std::string, std::string> asks{{"secret_variable", "IOTCLOUD_TEST_SECRET"}};
  EXPECT_EQ(facts(asks)["secret_variable"], "none");
  take_back("a");
  gateway_.reset();
  environment_ = {"IOTCLOUD_TEST_SECRET"};
  EXPECT_EQ(facts(asks)["secret_variable"], "sesame") << "the configuration names it";
  unsetenv("IOTCLOUD_TEST_SECRET");
}

TEST_F(ConfinedHosts, HaveAsManyProcessesAsTheyMay) {
  confinement_.processes = 3000;
  EXPECT_EQ(facts()["processes"], "3000");
}

TEST_F(ConfinedHosts, ConnectOnlyToThePortsThatTheyMay) {
  if (processes::landlock_version() < processes::landlock_of_connections)
    GTEST_SKIP() << "this kernel cannot restrict connections";
  const tests::LoopbackListener allowed, other;
  const std::map<std::string, std::string> asks{{"port", std::to_string(allowed.port())},
                                                {"other_port", std::to_string(other.port())},
                                                {"near", "127.0.0.1"},
                                                {"far", "::1"}};
  auto found = facts(asks);
  // What a kernel without IPv6 or MPTCP says.
  const std::set<std::string> of_another_kernel{"EADDRNOTAVAIL", "EAFNOSUPPORT", "EPROTONOSUPPORT", "ENOPROTOOPT"};
  for (const char* fact : {"port", "other_port", "other_port_by_first_data", "other_port_by_mptcp", "near", "far"}) {
    if (of_another_kernel.contains(found[fact])) continue;
    EXPECT_EQ(found[fact], "ok") << fact << ", the attack, without a confinement";
  }
  take_back("a");
  gateway_.reset();
  confinement_.no_new_privileges = confinement_.filter_calls = true;
  ports_ = {{"all", {9}}, {"confined.so", {allowed.port()}}, {"another.so", {other.port()}}};
  found = facts(asks);
  EXPECT_EQ(found["port"], "ok") << "the configuration names it for this plugin";
  EXPECT_EQ(found["other_port"], "EACCES");
  EXPECT_EQ(found["other_port_by_mptcp"], "EPERM") << "which Landlock does not see";
  EXPECT_EQ(found["other_port_by_first_data"], "EPERM") << "nor this";
  EXPECT_EQ(found["near"], "EPERM") << "a datagram";
  EXPECT_EQ(found["far"], "EPERM") << "one of IPv6";
}

/// A server of names at port 53 of an address of its own, by TCP only: every name is 192.0.2.7.
class NamesByTcp {
 public:
  static constexpr const char* address = "127.53.0.1";
  NamesByTcp() : socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in at{};
    at.sin_family = AF_INET;
    at.sin_port = htons(53);
    inet_pton(AF_INET, address, &at.sin_addr);
    const int yes = 1;
    setsockopt(socket_, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    if (bind(socket_, reinterpret_cast<const sockaddr*>(&at), sizeof at) != 0 || listen(socket_, 8) != 0)
      throw std::runtime_error("no name server at port 53");
    thread_ = std::jthread([this] { serve(); });
  }
  ~NamesByTcp() {
    shutdown(socket_, SHUT_RDWR);
    thread_.join();
    close(socket_);
  }
  NamesByTcp(const NamesByTcp&) = delete;
  NamesByTcp& operator=(const NamesByTcp&) = delete;
  int asked() const { return asked_; }

 private:
  void serve() {
    for (int client = accept(socket_, nullptr, nullptr); client >= 0; client = accept(socket_, nullptr, nullptr)) {
      std::array<unsigned char, 512> question{};
      const auto size = recv(client, question.data(), question.size(), 0);
      constexpr ssize_t header = 2 + 12;  // the length, and what stands before the question
      if (size > header) {
        ++asked_;
        std::string answer(question.data() + 2, question.data() + size);
        answer[2] = '\x81', answer[3] = '\x80', answer[7] = 1;  // an answer, with one record
        answer += std::string("\xc0\x0c\0\1\0\1\0\0\0\0\0\4\xc0\0\2\7", 16);
        const std::string length{static_cast<char>(answer.size() >> 8U), static_cast<char>(answer.size())};
        send(client, (length + answer).data(), length.size() + answer.size(), MSG_NOSIGNAL);
      }
      close(client);
    }
  }
  const int socket_;
  std::atomic<int> asked_{0};
  std::jthread thread_;
};

TEST_F(ConfinedHosts, AskForNamesByTcp) {
  if (processes::landlock_version() < processes::landlock_of_connections)
    GTEST_SKIP() << "this kernel cannot restrict connections";
  if (geteuid() != 0) GTEST_SKIP() << "only root may give a process another /etc/resolv.conf";
  const NamesByTcp names;
  const auto resolver = tests::write_file(
      folder_ / "resolv.conf", "nameserver " + std::string(NamesByTcp::address) + "\noptions attempts:1 timeout:1\n");
  host_program_ =
      tests::write_file(folder_ / "host", "#!/bin/sh\nexec unshare --mount sh -c 'mount --bind " + resolver +
                                              " /etc/resolv.conf && exec " HOST_PROGRAM " \"$@\"' sh \"$@\"\n");
  chmod(host_program_.c_str(), 0700);
  const std::map<std::string, std::string> asks{{"name", "broker.iotcloud.test"}};
  EXPECT_NE(facts(asks)["name"], "192.0.2.7") << "it asks by datagrams, to which nobody answers";
  take_back("a");
  gateway_.reset();
  confinement_.no_new_privileges = confinement_.filter_calls = true;
  ports_ = {{"all", {53}}};
  EXPECT_EQ(facts(asks)["name"], "192.0.2.7");
  EXPECT_EQ(names.asked(), 1);
  take_back("a");
  gateway_.reset();
  ports_ = {{"all", {9}}};
  EXPECT_NE(facts(asks)["name"], "192.0.2.7") << "the port is not named";
  EXPECT_EQ(names.asked(), 1);
}

/// SECURITY.md: a local socket has no port, and a service that answers there asks for names, say, in a host's place.
TEST_F(ConfinedHosts, ThatMayConnectToNoPortAskAServiceOfTheirMachineAtItsLocalSocket) {
  if (processes::landlock_version() < processes::landlock_of_connections)
    GTEST_SKIP() << "this kernel cannot restrict connections";
  const auto service = processes::listen_in(folder_, "names");
  std::jthread answers([&] {
    const int client = accept(service.get(), nullptr, nullptr);
    EXPECT_EQ(send(client, "192.0.2.7", 9, MSG_NOSIGNAL), 9);
    close(client);
  });
  // However the test ends and if nobody came, too: nobody is waited for any more.
  const std::shared_ptr<void> over(nullptr, [&](void*) { shutdown(service.get(), SHUT_RDWR); });
  confinement_.no_new_privileges = confinement_.filter_calls = true;
  confinement_.files.emplace();
  ports_ = {{"all", {9}}};
  EXPECT_EQ(facts({{"local_service", folder_ / "names"}})["local_service"], "192.0.2.7");
}

TEST_F(ConfinedHosts, ReachOnlyTheFilesThatTheyMay) {
  if (processes::landlock_version() == 0) GTEST_SKIP() << "this kernel has no Landlock";
  const auto secret = tests::write_file(folder_ / "tokens", "anna:admin:...");
  const auto shared = folder_ / "shared";
  fs::create_directories(shared);
  const std::map<std::string, std::string> asks{{"secret_file", secret}, {"forbidden_file", folder_ / "new"}};
  auto found = facts(asks);
  EXPECT_EQ(found["secret_file"], "ok") << "the attack, without a confinement";
  EXPECT_EQ(found["forbidden_file"], "ok");
  EXPECT_EQ(found["signal_to_parent"], "ok");
  take_back("a");
  gateway_.reset();
  confinement_.no_new_privileges = true;
  confinement_.files.emplace();
  found = facts(asks);
  EXPECT_EQ(found["secret_file"], "EACCES");
  EXPECT_EQ(found["forbidden_file"], "EACCES");
  EXPECT_EQ(found["program"], "ok");
  const bool signals_too = processes::landlock_version() >= 6;
  EXPECT_EQ(found["signal_to_parent"], signals_too ? "EPERM" : "ok");
  // Devices are there for all that the kernel lets their user do.
  found = facts_here({{"secret_file", "/dev/zero"}, {"forbidden_file", "/dev/full"}}, "b");
  EXPECT_EQ(found["secret_file"], "ok");
  EXPECT_EQ(found["forbidden_file"], "ok");
  take_back("a");
  take_back("b");
  gateway_.reset();
  confinement_.files = processes::FileAccess{{secret}, {shared}};
  found = facts({{"secret_file", secret}, {"forbidden_file", shared / "new"}});
  EXPECT_EQ(found["secret_file"], "ok") << "the configuration names it";
  EXPECT_EQ(found["forbidden_file"], "ok");
}

TEST_F(ConfinedHosts, ReachSpoolsAndLogsInTheStateFolderAndNothingElseThere) {
  if (processes::landlock_version() == 0) GTEST_SKIP() << "this kernel has no Landlock";
  // By this file a host would order the others about; the versions of plugins stand beside it.
  const std::map<std::string, std::string> asks{
      {"secret_file", state_ / "hosts-secret"}, {"forbidden_file", state_ / "id"}, {"chatter", "true"}};
  auto attack = facts(asks);
  EXPECT_EQ(attack["secret_file"], "ok") << "without a confinement";
  EXPECT_EQ(attack["forbidden_file"], "ok");
  take_back("a");
  gateway_.reset();
  fs::remove_all(state_ / "logs");
  confinement_.no_new_privileges = true;
  confinement_.files.emplace();
  auto found = facts(asks);
  EXPECT_EQ(found["secret_file"], "EACCES");
  EXPECT_EQ(found["forbidden_file"], "EACCES");
  EXPECT_TRUE(eventually([&] { return fs::exists(state_ / "logs/confined.log.2"); })) << "it moves its own log on";
  take_back("a");
  give(order("b", {{"channel.readings.when_full", "spool"}}));
  EXPECT_TRUE(comes_to("b", DriverState::active));
  EXPECT_TRUE(eventually([&] { return fs::exists(state_ / "spool/b/readings"); }));
}

TEST_F(ConfinedHosts, ReadABrokersFileThatReplacedTheOneOfTheirStart) {
  if (processes::landlock_version() == 0) GTEST_SKIP() << "this kernel has no Landlock";
  const fs::path list = tests::write_file(folder_ / "revoked.pem", "the list of the start");
  const auto replace = [&] { config::replace_file(list, "a renewed list", 0600); };
  confinement_.no_new_privileges = true;
  confinement_.files = processes::FileAccess{{list}, {}};
  EXPECT_EQ(facts({{"secret_file", list}})["secret_file"], "ok");
  replace();
  EXPECT_EQ(facts_here({{"secret_file", list}}, "b")["secret_file"], "EACCES") << "the kernel looks at the file";
  take_back("a");
  take_back("b");
  gateway_.reset();
  confinement_.files.emplace();
  broker_files_ = {list};
  start_gateway();
  const auto copy = only_broker_file();
  EXPECT_EQ(facts_here({{"secret_file", copy}})["secret_file"], "ok");
  replace();
  launcher_->renew_broker_files();
  EXPECT_EQ(tests::read_file(copy), "a renewed list");
  EXPECT_EQ(facts_here({{"secret_file", copy}}, "b")["secret_file"], "ok");
  EXPECT_EQ(sockets().size(), 1u) << "in the same host";
}

TEST_F(ConfinedHosts, WhoseBrokersFilesAreOthersNowAreNotAdopted) {
  const auto before = tests::write_file(folder_ / "before.pem", "an authority");
  const auto now = tests::write_file(folder_ / "now.pem", "an authority");
  for (const bool confined_now : {true, false}) {
    confinement_.no_new_privileges = true;
    confinement_.files.emplace();
    broker_files_ = {before};
    const int host = host_without_gateway(before);
    ASSERT_GT(host, 0);
    EXPECT_EQ(new_launcher()->running("gw"_gateway).size(), 1U) << "nothing is changed";
    broker_files_ = {now};
    if (!confined_now) confinement_.files.reset();
    const auto launcher = new_launcher();
    const tests::CapturedLog log;
    ASSERT_TRUE(launcher->running("gw"_gateway).empty());
    EXPECT_TRUE(log.contains("its brokers' files are others now"));
    EXPECT_TRUE(eventually([&] { return waitpid(host, nullptr, WNOHANG) == host; })) << "it was not killed";
  }
}

TEST_F(ConfinedHosts, LeaveNoCopiesOfPasswordsToAGatewayThatDoesNotConfineThemToFilesAnyMore) {
  confinement_.files.emplace();
  broker_files_ = {tests::write_file(folder_ / "password", "sesame")};
  new_launcher();
  EXPECT_TRUE(fs::exists(state_ / "broker-files"));
  confinement_.files.reset();
  new_launcher();
  EXPECT_FALSE(fs::exists(state_ / "broker-files"));
}

/// SECURITY.md: all hosts of a gateway have one user, and what `host_files` leaves them has all spools in it.
TEST_F(ConfinedHosts, OfOneGatewayReadAndChangeEachOthersSpools) {
  if (processes::landlock_version() == 0) GTEST_SKIP() << "this kernel has no Landlock";
  confinement_.no_new_privileges = true;
  confinement_.files.emplace();
  start_gateway();
  give(order("b", {{"channel.readings.when_full", "spool"}}));
  ASSERT_TRUE(comes_to("b", DriverState::active));
  const fs::path spool = state_ / "spool/b/readings";
  ASSERT_TRUE(eventually([&] { return fs::exists(spool) && !fs::is_empty(spool); }));
  auto found =
      facts_here({{"secret_file", fs::directory_iterator(spool)->path()}, {"forbidden_file", spool / "put-there"}});
  EXPECT_EQ(found["secret_file"], "ok");
  EXPECT_EQ(found["forbidden_file"], "ok");
}

TEST_F(ConfinedHosts, ThatCannotBeConfinedRunNoDriverAndSayWhy) {
  confinement_.open_files = std::uint64_t{1} << 40;
  start_gateway();
  give(quiet("a", "confined.so"));
  ASSERT_TRUE(comes_to("a", DriverState::failed, "confined"));
  EXPECT_THAT(record("a", "confined")->reason, HasSubstr("cannot have 1099511627776 files open"));
}

/// A gateway that runs as root, and hosts that do not.
class HostsOfAnotherUser : public ConfinedHosts {
 protected:
  void SetUp() override {
    if (geteuid() != 0) GTEST_SKIP() << "only root can become another user";
    confinement_.user = "nobody";
    chmod(folder_.c_str(), 0711);  // to the state folder and the plugins
  }

  static uid_t owner(const fs::path& path) {
    struct stat status {};
    return stat(path.c_str(), &status) == 0 ? status.st_uid : uid_t{0} - 1;
  }
  /// A host that outlived its gateway; its process, 0: there is none.
  int leave_host_running() {
    StatusLog told;
    const auto link = new_launcher()->launch({"probe.so", "gw"_gateway, false},
                                             {[&](const auto& s) { told.add(s); }, [](const auto&) {}});
    InstanceSpec spec;
    spec.order = quiet("a");
    spec.brokers = {{"local", "embedded", {}, {"embedded://x"}, {"embedded://x"}}};
    link->create(spec);
    return told.wait_for("a", DriverState::active) ? host_process() : 0;
  }
  const processes::Account nobody_ = processes::find_account("nobody");
};

TEST_F(HostsOfAnotherUser, AreNotRootAndCannotBecomeIt) {
  auto found = facts({{"forbidden_file", state_ / "id"}});
  EXPECT_EQ(found["user"], std::to_string(nobody_.user));
  EXPECT_EQ(found["group"], std::to_string(nobody_.group));
  EXPECT_EQ(found["groups_of_root"], "no");
  EXPECT_EQ(found["root_again"], "EPERM");
  EXPECT_EQ(found["forbidden_file"], "EACCES") << "the state folder is the gateway's";
}

TEST_F(HostsOfAnotherUser, ReadWhatReplacedABrokersFileAndOthersDoNot) {
  if (processes::landlock_version() == 0) GTEST_SKIP() << "this kernel has no Landlock";
  const fs::path password = tests::write_file(folder_ / "password", "sesame");
  chmod(password.c_str(), 0600);  // which only the gateway could read
  confinement_.no_new_privileges = true;
  confinement_.files.emplace();
  broker_files_ = {password};
  start_gateway();
  config::replace_file(password, "open sesame", 0600);
  launcher_->renew_broker_files();
  const auto copy = only_broker_file();
  EXPECT_THAT(facts_here({{"secret_file", copy}, {"forbidden_file", state_ / "broker-files/new"}}),
              AllOf(Contains(Pair("secret_file", "ok")), Contains(Pair("forbidden_file", "EACCES"))));
  EXPECT_EQ(tests::read_file(copy), "open sesame");
  EXPECT_EQ(fs::status(copy).permissions(), fs::perms::owner_read | fs::perms::owner_write | fs::perms::group_read);
  const auto stamp = config::stamp_of(copy);
  new_launcher();
  EXPECT_EQ(config::stamp_of(copy), stamp) << "a gateway that starts again changes nothing for its hosts";
}

/// What a host does to its gateway, if it has its gateway's user and `host_files` is not set.
TEST_F(HostsOfAnotherUser, DoNotReachTheMemoryOfADaemonOfTheirUserAlsoWithoutAFileRule) {
  const auto reached = [this](bool debuggable) {
    std::array<int, 2> ready{};
    EXPECT_EQ(pipe(ready.data()), 0);
    const pid_t victim = fork();
    if (victim == 0) {  // a daemon: config/daemon/daemon.cc
      if (setgid(nobody_.group) != 0 || setuid(nobody_.user) != 0) _exit(1);
      prctl(PR_SET_DUMPABLE, debuggable ? 1 : 0, 0, 0, 0);
      if (write(ready[1], "x", 1) != 1) _exit(1);
      for (;;) pause();
    }
    char byte = 0;
    EXPECT_EQ(read(ready[0], &byte, 1), 1);
    auto found = facts({{"victim", std::to_string(victim)}});
    kill(victim, SIGKILL);
    waitpid(victim, nullptr, 0);
    for (const int end : ready) close(end);
    take_back("a");
    gateway_.reset();
    return found;
  };
  confinement_.no_new_privileges = confinement_.filter_calls = true;
  EXPECT_EQ(reached(true)["environment_of_victim"], "ok") << "the attack";
  auto found = reached(false);
  EXPECT_EQ(found["environment_of_victim"], "EACCES");
  EXPECT_EQ(found["memory_of_victim"], "EACCES");
  EXPECT_EQ(found["ptrace_of_victim"], "EPERM");
}

TEST_F(HostsOfAnotherUser, StartNoMoreProcessesThanTheyMay) {
  constexpr int most = 300;
  const std::map<std::string, std::string> asks{{"children", std::to_string(most)}};
  auto found = facts(asks);
  EXPECT_EQ(found["children"], std::to_string(most)) << "the attack";
  take_back("a");
  gateway_.reset();
  confinement_.processes = most;
  found = facts(asks);
  EXPECT_EQ(found["next_child"], "EAGAIN");
  EXPECT_LT(std::stoi(found["children"]), most);
}

TEST_F(HostsOfAnotherUser, SpoolAndEndInOrder) {
  start_gateway();
  give(order("a", {{"channel.readings.when_full", "spool"}}));
  ASSERT_TRUE(comes_to("a", DriverState::active));
  EXPECT_TRUE(eventually([&] { return owner(state_ / "spool/a/readings") == nobody_.user; }));
  const int process = host_process();
  take_back("a");
  EXPECT_TRUE(has_ended(process));
  EXPECT_TRUE(eventually([&] { return sockets().empty(); }));
}

TEST_F(HostsOfAnotherUser, LogIntoFilesThatTheirGatewayMovesOn) {
  give(quiet("a", "confined.so", {{"chatter", "true"}}));
  start_gateway();
  // The second is moved only when the host went on in a new one.
  EXPECT_TRUE(eventually([&] { return fs::exists(state_ / "logs/confined.log.2"); }));
  // Older ones move first; then the log itself is moved, and made anew.
  EXPECT_TRUE(eventually([&] { return owner(state_ / "logs/confined.log") == nobody_.user; }));
  EXPECT_EQ(owner(state_), 0u);
  EXPECT_EQ(owner(state_ / "logs"), 0u);
}

TEST_F(HostsOfAnotherUser, AreAdopted) {
  const int process = leave_host_running();
  ASSERT_GT(process, 0);
  EXPECT_EQ(new_launcher()->running("gw"_gateway).size(), 1u);
  EXPECT_EQ(host_process(), process);
}

TEST_F(HostsOfAnotherUser, AreAdoptedOnlyAsTheOneThatTheConfigurationNames) {
  confinement_.user = "";
  const int process = leave_host_running();
  ASSERT_GT(process, 0);
  confinement_.user = "nobody";
  EXPECT_TRUE(new_launcher()->running("gw"_gateway).empty());
  EXPECT_TRUE(sockets().empty());
}

TEST_F(HostsOfAnotherUser, TheUserMustBeThereAndHaveFewerRights) {
  confinement_.user = "no-such-user";
  EXPECT_THROW(new_launcher(), config::Error);
  confinement_.user = "root";
  EXPECT_THROW(new_launcher(), config::Error);
}

TEST_F(HostsOfAnotherUser, SpoolsOfAThirdOneAreLeftToIt) {
  fs::create_directories(state_ / "spool");
  ASSERT_EQ(chown((state_ / "spool").c_str(), 1, 1), 0);
  EXPECT_THROW(new_launcher(), config::Error);
  ASSERT_EQ(chown((state_ / "spool").c_str(), 0, 0), 0);
  fs::create_directories(state_ / "spool/a");
  new_launcher();
  EXPECT_EQ(owner(state_ / "spool/a"), nobody_.user);
}

}  // namespace
}  // namespace iotcloud::gateway
