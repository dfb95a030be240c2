// Whom driver hosts reach that may connect to some places only, as drivers in real processes see it.
#include <array>
#include <map>
#include <mutex>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/processes/landlock.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/fleet/process_fixture.h>
#include <iotcloud/tests/gateway/status_log.h>
#include <iotcloud/tests/loopback_listener.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::HasSubstr;
namespace fs = std::filesystem;
using Properties = std::map<std::string, std::string>;

std::string place_at(const tests::LoopbackListener& listener) {
  return "127.0.0.1:" + std::to_string(listener.port());
}

/// Whether somebody waits to be accepted.
bool was_reached(int listener) {
  pollfd on{listener, POLLIN, 0};
  return poll(&on, 1, 0) == 1;
}

void accept_all(int listener) {
  while (was_reached(listener)) close(accept(listener, nullptr, nullptr));
}

class HostsWithANetwork : public ProcessTest {
 protected:
  HostsWithANetwork() { fs::copy(fs::path(TEST_PLUGINS) / "networked.so", plugins_ / "networked.so"); }
  void SetUp() override {
    if (processes::landlock_version() == 0) GTEST_SKIP() << "this kernel has no Landlock";
  }

  /// What a gateway must confine for a list of places.
  void confine_hosts() {
    confinement_.no_new_privileges = confinement_.filter_calls = true;
    confinement_.debuggable = false;
    confinement_.files.emplace();
    if (geteuid() != 0) return;
    confinement_.user = "nobody";
    chmod(folder_.c_str(), 0711);  // to the state folder and the plugins
  }
  void deploy(const Properties& properties) { give(quiet("a", "networked.so", properties)); }
  /// What the driver says in this state, once it says so.
  Properties facts_when(DriverState state) {
    EXPECT_TRUE(comes_to("a", state, "networked"));
    EXPECT_TRUE(eventually([&] {
      const auto now = record("a", "networked");
      return now && now->metadata.contains("tried");
    }));
    const auto now = record("a", "networked");
    return now ? now->metadata : Properties{};
  }
  /// What a driver in such a host finds out.
  Properties facts(const Properties& properties) {
    start_gateway();
    deploy(properties);
    return facts_when(DriverState::active);
  }
  /// Why the deployment failed.
  std::string reason(const Properties& properties) {
    start_gateway();
    deploy(properties);
    EXPECT_TRUE(comes_to("a", DriverState::failed, "networked"));
    const auto now = record("a", "networked");
    end();
    return now ? now->reason : "";
  }
  void end() {
    take_back("a");
    EXPECT_TRUE(eventually([&] { return !record("a", "networked"); }));
    gateway_.reset();
  }
  std::string log() const { return tests::read_file(state_ / "logs/networked.log"); }

  /// The processes that make connections for hosts of this test.
  std::set<pid_t> connectors() const {
    std::set<pid_t> found;
    for (const auto& entry : fs::directory_iterator("/proc")) {
      const std::string name = entry.path().filename();
      if (name.find_first_not_of("0123456789") != std::string::npos) continue;
      if (said_by(entry.path() / "comm") == "connector\n" &&
          said_by(entry.path() / "cmdline").find(state_.string()) != std::string::npos) {
        found.insert(std::stoi(name));
      }
    }
    return found;
  }
  /// What a file of /proc says; empty if its process has ended.
  static std::string said_by(const fs::path& file) try {
    return tests::read_file(file);
  } catch (const std::exception&) {
    return "";
  }
};

TEST_F(HostsWithANetwork, ConnectToThePlacesOfTheirDeploymentAndByNoWayToAnother) {
  const tests::LoopbackListener allowed, other;
  Properties asks{{"place", "localhost " + std::to_string(allowed.port())},
                  {"port", std::to_string(allowed.port())},
                  {"escape", std::to_string(other.port())}};
  auto found = facts(asks);
  EXPECT_EQ(found["place"], "ok");
  // What a kernel without IPv6 or MPTCP says, and one for programs of 64 bits only.
  const std::set<std::string> of_another_kernel{"EADDRNOTAVAIL", "EAFNOSUPPORT", "EPROTONOSUPPORT", "ENOPROTOOPT",
                                                "ENOSYS"};
  for (const auto& [fact, outcome] : found) {
    if (!fact.starts_with("escape") || of_another_kernel.contains(outcome)) continue;
    EXPECT_EQ(outcome, "ok") << fact << ", the attack, without a confinement";
  }
  EXPECT_NE(found["another_protocol"], "EPERM");
  if (geteuid() == 0) {
    EXPECT_NE(found["another_way"], "EPERM") << "which the kernel lets only those do who have rights";
  }
  EXPECT_EQ(found["raced"], "yes");
  EXPECT_TRUE(was_reached(other.socket()));
  end();
  for (const auto* listener : {&allowed, &other}) accept_all(listener->socket());

  confine_hosts();
  asks["network"] = "localhost:" + std::to_string(allowed.port());
  found = facts(asks);
  EXPECT_EQ(found["place"], "ok");
  EXPECT_EQ(found["port"], "ok") << "an address that the name has";
  EXPECT_EQ(found["port_at_once"], "ok");
  int escapes = 0;
  for (const auto& [fact, outcome] : found) {
    if (!fact.starts_with("escape")) continue;
    ++escapes;
    EXPECT_THAT(outcome, AnyOf("EACCES", "EPERM")) << fact;
  }
  EXPECT_GE(escapes, 10);
  EXPECT_EQ(found["escape_by_library"], "EACCES");
  EXPECT_EQ(found["another_protocol"], "EPERM");
  EXPECT_EQ(found["another_way"], "EPERM");
  EXPECT_EQ(found["raced"], "yes");
  EXPECT_FALSE(was_reached(other.socket()));
  EXPECT_THAT(log(), AllOf(HasSubstr("kept from connecting to " + std::string("127.0.0.1 port ") +
                                     std::to_string(other.port())),
                           HasSubstr("`network`"), HasSubstr("`host_network`")));
}

TEST_F(HostsWithANetwork, HaveNoOtherKindsOfSockets) {
  const Properties asks{{"families", "true"}};
  EXPECT_THAT(facts(asks)["families"], AllOf(HasSubstr("1.2 "), HasSubstr("2.2 "), HasSubstr("16.3.4 ")));
  end();
  confine_hosts();
  std::istringstream made(facts({{"families", "true"}, {"network", ""}})["families"]);
  const std::string of_ip6 = std::to_string(AF_INET6) + ".1";
  const std::set<std::string> expected{"1.1", "1.5", "2.1", of_ip6, "16.2", "16.3", "16.2.15", "16.3.15"};
  for (std::string one; made >> one;) EXPECT_TRUE(expected.contains(one)) << one;
}

TEST_F(HostsWithANetwork, ReachNoLocalSocketsOfOthers) {
  // Such as those at which services of the machine ask for names.
  const auto path = folder_ / "s";
  std::array<int, 2> listeners{};
  for (const bool datagrams : {false, true}) {
    sockaddr_un at{};
    at.sun_family = AF_UNIX;
    const std::string name = path.string() + (datagrams ? ".dgram" : "");
    ASSERT_LT(name.size(), sizeof at.sun_path);
    name.copy(at.sun_path, sizeof at.sun_path - 1);
    const int made = socket(AF_UNIX, (datagrams ? SOCK_DGRAM : SOCK_STREAM) | SOCK_CLOEXEC, 0);
    listeners.at(datagrams ? 1 : 0) = made;
    ASSERT_EQ(bind(made, reinterpret_cast<const sockaddr*>(&at), sizeof at), 0);
    chmod(name.c_str(), 0777);
    if (!datagrams) {
      ASSERT_EQ(listen(made, 8), 0);
    }
  }
  const Properties asks{{"local", path}};
  auto found = facts(asks);
  for (const char* way : {"local", "local_by_call", "local_datagram", "local_datagram_of_a_pair"})
    EXPECT_EQ(found[way], "ok") << way << ", the attack, without a confinement";
  end();
  accept_all(listeners[0]);
  std::array<char, 8> bytes{};
  while (recv(listeners[1], bytes.data(), bytes.size(), MSG_DONTWAIT) > 0) {
  }
  confine_hosts();
  found = facts({{"local", path}, {"network", ""}});
  EXPECT_EQ(found["local"], "EACCES");
  EXPECT_EQ(found["local_by_call"], "EACCES");
  EXPECT_EQ(found["local_datagram"], "EPERM");
  EXPECT_EQ(found["local_datagram_of_a_pair"], "EPERM");
  for (const int listener : listeners) {
    EXPECT_FALSE(was_reached(listener));
    close(listener);
  }
}

/// A server of names at port 53 of an address of its own, by TCP only: every name is 192.0.2.7.
class NameServer {
 public:
  static constexpr const char* address = "127.53.0.2";
  NameServer() : socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
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
  ~NameServer() {
    shutdown(socket_, SHUT_RDWR);
    thread_.join();
    close(socket_);
  }
  NameServer(const NameServer&) = delete;
  NameServer& operator=(const NameServer&) = delete;
  /// All that it was asked, as it came.
  std::string asked() const {
    const std::lock_guard lock(mutex_);
    return asked_;
  }

 private:
  void serve() {
    for (int client = accept(socket_, nullptr, nullptr); client >= 0; client = accept(socket_, nullptr, nullptr)) {
      std::string bytes;
      std::array<char, 512> part{};
      for (ssize_t size = 0; (size = recv(client, part.data(), part.size(), 0)) > 0;) {
        bytes.append(part.data(), static_cast<std::size_t>(size));
        while (answer_first(client, bytes)) {
        }
      }
      close(client);
    }
  }
  /// Answers the first question, if it is whole, and takes it away.
  bool answer_first(int client, std::string& bytes) {
    constexpr std::size_t header = 12;
    if (bytes.size() < 2) return false;
    const std::size_t size = static_cast<unsigned char>(bytes[0]) * 256U + static_cast<unsigned char>(bytes[1]);
    if (bytes.size() < 2 + size || size < header) return false;
    const auto name_ends = bytes.find('\0', 2 + header);
    const bool of_ip4 = bytes.at(name_ends + 2) == 1;
    std::string answer = bytes.substr(2, name_ends + 5 - 2);
    {
      const std::lock_guard lock(mutex_);
      asked_ += answer.substr(header) + "\n";
    }
    bytes.erase(0, 2 + size);
    answer[2] = '\x81', answer[3] = '\x80', answer[7] = of_ip4 ? 1 : 0;  // an answer, with one record or none
    answer[9] = answer[11] = 0;
    if (of_ip4) answer += std::string("\xc0\x0c\0\1\0\1\0\0\0\0\0\4\xc0\0\2\7", 16);
    const std::string length{static_cast<char>(answer.size() >> 8U), static_cast<char>(answer.size())};
    send(client, (length + answer).data(), length.size() + answer.size(), MSG_NOSIGNAL);
    return true;
  }
  const int socket_;
  mutable std::mutex mutex_;
  std::string asked_;
  std::jthread thread_;
};

TEST_F(HostsWithANetwork, AskForTheNamesOfTheirPlacesAndForNoOthers) {
  if (geteuid() != 0) GTEST_SKIP() << "only root may give a process another /etc/resolv.conf";
  const NameServer names;
  const auto resolver = tests::write_file(folder_ / "resolv.conf", "nameserver " + std::string(NameServer::address) +
                                                                       "\noptions use-vc attempts:1 timeout:1\n");
  host_program_ =
      tests::write_file(folder_ / "host", "#!/bin/sh\nexec unshare --mount sh -c 'mount --bind " + resolver +
                                              " /etc/resolv.conf && exec " HOST_PROGRAM " \"$@\"' sh \"$@\"\n");
  chmod(host_program_.c_str(), 0700);
  auto found = facts({{"name", "secret.iotcloud.test"}});
  EXPECT_EQ(found["name"], "192.0.2.7") << "the attack, without a confinement";
  EXPECT_EQ(found["name_by_library"], "192.0.2.7");
  EXPECT_THAT(names.asked(), HasSubstr("secret"));
  end();
  confine_hosts();
  found = facts({{"name", "Camera.iotcloud.test."}, {"network", "camera.iotcloud.test:554, 127.53.0.2:53"}});
  EXPECT_EQ(found["name"], "192.0.2.7");
  EXPECT_NE(found["name_by_library"], "192.0.2.7") << "around the connector";
  EXPECT_THAT(names.asked(), HasSubstr("camera"));
  end();
  found = facts({{"name", "other.iotcloud.test"}, {"network", "camera.iotcloud.test:554, 127.53.0.2:53"}});
  EXPECT_NE(found["name"], "192.0.2.7");
  EXPECT_NE(found["name_by_library"], "192.0.2.7");
  EXPECT_THAT(names.asked(), ::testing::Not(HasSubstr("other")));
  EXPECT_THAT(log(), HasSubstr("kept from asking for the name other.iotcloud.test"));
}

TEST_F(HostsWithANetwork, HaveTheirGatewaysPlacesIfTheDeploymentNamesNone) {
  const tests::LoopbackListener of_all, of_plugin, of_another, broker;
  confine_hosts();
  const auto listed = [](const tests::LoopbackListener& one) { return processes::parse_place(place_at(one)); };
  network_ = {{"all", {listed(of_all)}}, {"networked.so", {listed(of_plugin)}}, {"another.so", {listed(of_another)}}};
  brokers_places_ = {listed(broker)};
  const auto port_of = [&](const tests::LoopbackListener& one, Properties more = {}) {
    more["port"] = std::to_string(one.port());
    const auto outcome = facts(more)["port"];
    end();
    return outcome;
  };
  EXPECT_EQ(port_of(of_all), "ok");
  EXPECT_EQ(port_of(of_plugin), "ok");
  EXPECT_EQ(port_of(broker), "ok");
  EXPECT_EQ(port_of(of_another), "EACCES");
  const Properties narrower{{"network", place_at(of_plugin)}};
  EXPECT_EQ(port_of(of_plugin, narrower), "ok");
  EXPECT_EQ(port_of(broker, narrower), "ok") << "whatever a deployment says";
  EXPECT_EQ(port_of(of_all, narrower), "EACCES") << "the deployment leaves it out";
  EXPECT_THAT(reason({{"network", place_at(of_another)}}),
              AllOf(HasSubstr(place_at(of_another)), HasSubstr("host_network")))
      << "a deployment gives no more than its gateway";
}

/// SECURITY.md: as one that an earlier version of the gateway sees in `network`.
TEST_F(HostsWithANetwork, AreNotRestrictedByAPropertyThatTheirGatewayDoesNotKnow) {
  const tests::LoopbackListener other;
  confine_hosts();
  const auto port = std::to_string(other.port());
  EXPECT_EQ(facts({{"network_by_another_name", "camera-1:554"}, {"port", port}})["port"], "ok");
  end();
  EXPECT_EQ(facts({{"network", "127.0.0.1:554"}, {"port", port}})["port"], "EACCES");
}

TEST_F(HostsWithANetwork, AreNotStartedWhereTheyWouldGetAroundIt) {
  const Properties asks{{"network", "camera-1:554"}};
  EXPECT_THAT(reason(asks), AllOf(HasSubstr("`network`"), HasSubstr("host_call_filter: true")));
  confine_hosts();
  confinement_.files.reset();
  EXPECT_THAT(reason(asks), HasSubstr("host_files"));
  confinement_.files.emplace();
  if (geteuid() == 0) {
    confinement_.user = "";
    EXPECT_THAT(reason(asks), HasSubstr("host_user"));
    confinement_.user = "nobody";
  }
  EXPECT_THAT(reason({{"network", "camera-1"}}), AllOf(HasSubstr("`network`: \"camera-1\""), HasSubstr("HOST:PORT")));
  ports_ = {{"all", {9}}};
  EXPECT_THAT(reason(asks), HasSubstr("host_ports"));
}

TEST_F(HostsWithANetwork, ThatADeploymentNamesAreOfOneInstance) {
  const tests::LoopbackListener allowed;
  confine_hosts();
  start_gateway();
  deploy({{"network", place_at(allowed)}, {"isolation", "plugin"}, {"port", std::to_string(allowed.port())}});
  give(quiet("b", "networked.so", {{"network", ""}, {"port", std::to_string(allowed.port())}}));
  EXPECT_EQ(facts_when(DriverState::active)["port"], "ok");
  ASSERT_TRUE(eventually([&] {
    const auto now = record("b", "networked");
    return now && now->metadata.contains("port");
  }));
  EXPECT_EQ(record("b", "networked")->metadata["port"], "EACCES");
  EXPECT_EQ(sockets().size(), 2u);
}

/// Hosts that outlive their gateway, or what connects for them.
class HostsWithANetworkThatLive : public HostsWithANetwork {
 protected:
  void SetUp() override {
    HostsWithANetwork::SetUp();
    if (!IsSkipped()) confine_hosts();
  }
  discovery::OrderRecord wanted(const std::string& network) const {
    return quiet("a", "networked.so", {{"network", network}, {"port", std::to_string(allowed_.port())}});
  }
  /// Starts a host that its gateway leaves behind. \param said the order as the host tells it. \return its process.
  int leave_host_running(const std::string& network, const discovery::OrderRecord& said) {
    StatusLog told;
    HostOrder order{"networked.so", "gw"_gateway, true};
    order.network = network;
    const auto link = new_launcher()->launch(order, {[&](const auto& s) { told.add(s); }, [](const auto&) {}});
    InstanceSpec spec;
    spec.order = said;
    spec.brokers = {{"local", "embedded", {}, {broker_url_}, {broker_url_}}};
    link->create(spec);
    return told.wait_for("a", DriverState::active) ? host_process() : 0;
  }
  /// Whether a host that leave_host_running() has started ends.
  static bool is_gone(int process) {
    return eventually([&] { return waitpid(process, nullptr, WNOHANG) == process; });
  }

  const tests::LoopbackListener allowed_;
};

TEST_F(HostsWithANetworkThatLive, ConnectWhenAnotherGatewayHasAdoptedThem) {
  auto order = wanted(place_at(allowed_));
  const int process = leave_host_running(place_at(allowed_), order);
  ASSERT_GT(process, 0);
  accept_all(allowed_.socket());
  give(order);
  start_gateway();
  EXPECT_TRUE(comes_to("a", DriverState::active, "networked"));
  EXPECT_EQ(host_process(), process);
  order.active = false;
  give(order);
  EXPECT_TRUE(comes_to("a", DriverState::inactive, "networked"));
  order.active = true;
  give(order);
  EXPECT_EQ(facts_when(DriverState::active)["port"], "ok");
  EXPECT_TRUE(was_reached(allowed_.socket()));
}

TEST_F(HostsWithANetworkThatLive, AreAdoptedOnlyWithThePlacesThatTheyWouldHaveNow) {
  const auto place = place_at(allowed_);
  ASSERT_GT(leave_host_running(place, wanted(place)), 0);
  brokers_places_ = {{"broker-1", 5671}};
  EXPECT_TRUE(new_launcher()->running("gw"_gateway).empty()) << "the configuration is another";
  EXPECT_TRUE(sockets().empty());
  brokers_places_.clear();
  ASSERT_GT(leave_host_running(place, wanted(place)), 0);
  EXPECT_EQ(new_launcher()->running("gw"_gateway).size(), 1u);
}

TEST_F(HostsWithANetworkThatLive, AreNotAdoptedWhenTheySayThatTheirDeploymentNamesMore) {
  const tests::LoopbackListener other;
  const auto lie = wanted(place_at(allowed_) + "," + place_at(other));
  const int process = leave_host_running(place_at(allowed_), lie);
  ASSERT_GT(process, 0);
  give(lie);  // as it is ordered meanwhile
  start_gateway();
  EXPECT_TRUE(is_gone(process));
  EXPECT_TRUE(comes_to("a", DriverState::active, "networked"));
}

TEST_F(HostsWithANetworkThatLive, LeaveNobodyBehindWhoConnectsForThem) {
  const auto place = place_at(allowed_);
  const int process = leave_host_running(place, wanted(place));
  ASSERT_GT(process, 0);
  EXPECT_EQ(connectors().size(), 1u);
  kill(process, SIGKILL);
  EXPECT_TRUE(is_gone(process));
  EXPECT_TRUE(eventually([&] { return connectors().empty(); }));
  EXPECT_TRUE(new_launcher()->running("gw"_gateway).empty());
  for (const auto& file : fs::directory_iterator(state_)) EXPECT_NE(file.path().extension(), ".network");
}

TEST_F(HostsWithANetworkThatLive, StartAgainWhenWhatConnectsForThemHasEnded) {
  auto order = wanted(place_at(allowed_));
  start_gateway();
  give(order);
  ASSERT_TRUE(comes_to("a", DriverState::active, "networked"));
  const int process = host_process();
  for (const pid_t connector : connectors()) kill(connector, SIGKILL);
  ASSERT_TRUE(eventually([&] { return connectors().empty(); }));
  order.active = false;
  give(order);
  ASSERT_TRUE(comes_to("a", DriverState::inactive, "networked"));
  order.active = true;
  give(order);
  EXPECT_TRUE(has_ended(process));
  EXPECT_TRUE(comes_to("a", DriverState::active, "networked"));
  EXPECT_EQ(connectors().size(), 1u);
}

}  // namespace
}  // namespace iotcloud::gateway
