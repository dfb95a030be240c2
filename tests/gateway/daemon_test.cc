// The daemon iotcloud-gateway with a real registry: what its driver hosts go through when it dies.
#include <chrono>
#include <filesystem>
#include <fstream>
#include <future>
#include <iterator>
#include <map>
#include <memory>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <signal.h>
#include <spawn.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <thrift/protocol/TBinaryProtocol.h>
#include <thrift/transport/TBufferTransports.h>
#include <thrift/transport/TSocket.h>
#include <unistd.h>

#include "iotcloud/gateway/TSensorSiteService.h"
#include <iotcloud/config/durable_write.h>
#include <iotcloud/discovery/freeze.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/processes/unix_socket.h>
#include <iotcloud/security/audit_chain.h>
#include <iotcloud/security/ed25519.h>
#include <iotcloud/tests/discovery/id_literals.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>
#include <iotcloud/tests/loopback_listener.h>
#include <iotcloud/tests/servers/free_port.h>
#include <iotcloud/tests/servers/private_server.h>

namespace iotcloud::gateway {
namespace {

using discovery::DriverState;
namespace fs = std::filesystem;

class DaemonTest : public ::testing::Test {
 protected:
  DaemonTest() {
    std::string pattern = fs::temp_directory_path() / "iotcloud-daemon-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    twin_ = folder_ / "twin";
    configure(TEST_PLUGINS);
    discovery::RegistryOptions options;
    options.url = zookeeper_.url();
    registry_ = discovery::make_registry(options);
  }
  ~DaemonTest() override {
    if (daemon_ > 0) end_daemon(SIGKILL);
    for (const auto& folder : {folder_, twin_}) {
      for (const int host : host_processes(folder)) kill(host, SIGKILL);
    }
    fs::remove_all(folder_);
  }

  /// \param more lines of its configuration.
  void configure(const std::string& plugins, const std::string& more = "") const {
    configure_in(folder_, plugins, more);
  }
  void configure_in(const fs::path& folder, const std::string& plugins, const std::string& more) const {
    std::ofstream(folder / "gateway.yaml")
        << "id: gw\nregistry: \"" << zookeeper_.url() << "\"\nthrift: {port: 0}\nplugins: " << plugins
        << "\nstate: " << (folder / "state").string() << "\nbrokers: {rabbitmq: {urls: [\"amqp://127.0.0.1:1/\"]}}\n"
        << more;
  }
  void start_daemon() { start_daemon_in(folder_); }
  /// Starts the one that is configured in the folder; it is daemon_ from now on.
  void start_daemon_in(const fs::path& folder) {
    const std::string program = GATEWAY_PROGRAM;
    const std::string config = folder / "gateway.yaml";
    const char* argv[] = {program.c_str(), "--config", config.c_str(), nullptr};
    ASSERT_EQ(posix_spawn(&daemon_, program.c_str(), nullptr, nullptr, const_cast<char**>(argv), environ), 0);
  }
  int end_daemon(int signal) {
    kill(daemon_, signal);
    int status = 0;
    waitpid(daemon_, &status, 0);
    daemon_ = 0;
    return status;
  }

  void give(bool active, const std::string& instance = "a", const std::string& plugin = "probe.so") {
    discovery::OrderRecord order;
    order.instance = discovery::InstanceId(instance);
    order.plugin = plugin;
    order.driver = "probe"_driver;
    order.active = active;
    order.properties = properties_;
    discovery::put(*registry_, paths_.order("gw"_gateway, discovery::InstanceId(instance)), encode(order));
  }
  std::optional<discovery::DriverRecord> record(const std::string& instance = "a") {
    const auto path = paths_.instance("probe"_driver, discovery::InstanceId(instance));
    const auto node = registry_->get(path);
    if (!node) return std::nullopt;
    return discovery::decode_driver(node->data, path);
  }
  bool comes_to(DriverState state, const std::string& instance = "a") {
    return eventually([&] {
      const auto now = record(instance);
      return now && now->state == state;
    });
  }
  /// Has the gateway itself deploy an instance. \return the outcome; none: it died meanwhile
  std::optional<DriverState> deploy_at(int port) const {
    namespace thrift = apache::thrift;
    const auto transport = std::make_shared<thrift::transport::TFramedTransport>(
        std::make_shared<thrift::transport::TSocket>("127.0.0.1", port));
    wire::TSensorSiteServiceClient client(std::make_shared<thrift::protocol::TBinaryProtocol>(transport));
    discovery::wire::TSensorDeployDescriptor descriptor;
    descriptor.__set_filename("probe.so");
    descriptor.__set_properties(properties_);
    discovery::wire::TResponse answer;
    try {
      transport->open();
      client.deploySensor(answer, descriptor);
    } catch (const thrift::TException&) {
      return std::nullopt;
    }
    return answer.state == discovery::wire::TResponseState::SUCCESS ? DriverState::active : DriverState::failed;
  }
  std::vector<int> host_processes() const { return host_processes(folder_); }
  static std::vector<int> host_processes(const fs::path& folder) {
    std::vector<int> hosts;
    std::error_code none;
    for (const auto& file : fs::directory_iterator(folder / "state", none)) {
      if (file.path().extension() != ".sock") continue;
      const int process = processes::peer_process(processes::connect_in(folder / "state", file.path().filename()));
      if (process > 0) hosts.push_back(process);  // 0: it has ended
    }
    return hosts;
  }
  int host_process() const {
    const auto hosts = host_processes();
    return hosts.empty() ? 0 : hosts.front();
  }
  /// The session that holds the gateway's ephemeral node; 0: there is no such node.
  std::int64_t alive_session() {
    const auto node = registry_->get(paths_.gateway_alive("gw"_gateway));
    return node ? node->owner_session : 0;
  }

  tests::PrivateServer zookeeper_{"zookeeper.py"};
  /// Starts the daemon with an active instance. \return its host's process; 0: it has none
  int start_with_host() {
    start_daemon();
    give(true);
    return comes_to(DriverState::active) ? host_process() : 0;
  }

  /// Another gateway of the same id takes the place, elsewhere, when it is free; it is daemon_ from now on. \return the
  /// host of its active instance; 0: it has none
  int start_twin() {
    EXPECT_TRUE(eventually([&] { return alive_session() == 0; })) << "the session has not expired";
    const auto before = record();
    fs::create_directory(twin_);
    configure_in(twin_, TEST_PLUGINS, lasting_);
    start_daemon_in(twin_);
    const bool active = eventually([&] {
      const auto now = record();
      return now && now->state == DriverState::active && now->since_ms != before->since_ms;
    });
    const auto hosts = host_processes(twin_);
    return active && hosts.size() == 1 ? hosts.front() : 0;
  }
  /// Who has the gateway's place, with which hosts, and what the instance's record says.
  std::tuple<std::int64_t, std::vector<int>, std::string> seen() {
    const auto now = record();
    return {alive_session(), host_processes(twin_), now ? encode(*now) : ""};
  }
  /// A gateway whose place another one has ends with an error, and the host that it left.
  static void expect_its_end(pid_t gateway, int host) {
    int status = 0;
    EXPECT_EQ(waitpid(gateway, &status, 0), gateway);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 1) << status;
    EXPECT_TRUE(eventually([&] { return kill(host, 0) != 0; }));
  }

  const discovery::Paths paths_;
  const std::string quick_ = "registry.session_timeout: 1s\n";
  /// Of who is to keep its session also on a busy machine; no longer than the lease of an instance.
  const std::string lasting_ = "registry.session_timeout: 6s\n";
  std::unique_ptr<discovery::Registry> registry_;
  fs::path folder_, twin_;
  std::map<std::string, std::string> properties_{{"channels", "none"}};
  pid_t daemon_ = 0;
};

TEST_F(DaemonTest, AHostOutlivesAGatewayThatIsKilledAndIsAdoptedWhenItReturns) {
  const int host = start_with_host();
  ASSERT_GT(host, 0);
  const auto before = record();
  const auto session = alive_session();

  end_daemon(SIGKILL);
  EXPECT_EQ(kill(host, 0), 0) << "the host died with its gateway";

  start_daemon();
  EXPECT_TRUE(eventually([&] { return alive_session() != 0 && alive_session() != session; }));
  give(false);  // the adopted host follows orders
  EXPECT_TRUE(comes_to(DriverState::inactive));
  give(true);
  EXPECT_TRUE(comes_to(DriverState::active));
  EXPECT_EQ(host_process(), host);
  EXPECT_EQ(record()->instance, before->instance);

  const int status = end_daemon(SIGTERM);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
  EXPECT_TRUE(eventually([&] { return kill(host, 0) != 0; }));
  EXPECT_EQ(record()->state, DriverState::inactive);
  // A gateway that ends does not wait for the registry's answer for long; then its session ends a little later.
  EXPECT_TRUE(eventually([&] { return alive_session() == 0; })) << "the place is not free";
}

TEST_F(DaemonTest, AGatewayWhosePortIsTakenDoesNotRegister) {
  for (const std::string taken : {"thrift: {port: ", "metrics: {address: \"127.0.0.1:"}) {
    const tests::LoopbackListener other;
    configure(TEST_PLUGINS);
    std::string config = tests::read_file(folder_ / "gateway.yaml");
    const bool thrift = taken.starts_with("thrift");
    if (thrift) {
      config.replace(config.find("port: 0"), 7, "port: " + std::to_string(other.port()));
    } else {
      config += taken + std::to_string(other.port()) + "\"}\n";
    }
    tests::write_file(folder_ / "gateway.yaml", config);
    start_daemon();
    int status = 0;
    ASSERT_EQ(waitpid(std::exchange(daemon_, 0), &status, 0) > 0, true);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) != 0) << status;
    EXPECT_FALSE(registry_->get(paths_.gateway("gw"_gateway))) << config;
  }
}

TEST_F(DaemonTest, ItWaitsForARegistryThatIsAwayAndWorksWhenItComes) {
  zookeeper_.kill();
  start_daemon();
  zookeeper_.start();
  give(true);
  EXPECT_TRUE(comes_to(DriverState::active));
}

TEST_F(DaemonTest, AZooKeeperThatLostItsDiskStopsNothingAndIsFollowedWhenItIsAdopted) {
  configure(TEST_PLUGINS, "registry.session_timeout: 1s\n");
  start_daemon();
  give(true);
  ASSERT_TRUE(comes_to(DriverState::active));
  const auto before = record();
  const int host = host_process();

  zookeeper_.kill();
  ASSERT_GT(fs::remove_all(zookeeper_.folder() / "data" / "version-2"), 0U);
  zookeeper_.start();
  discovery::RegistryOptions options;
  options.url = zookeeper_.url();
  registry_ = discovery::make_registry(options);  // the former client has seen a later state, and would wait
  const auto mark = discovery::freeze_path(paths_, "gw"_gateway);
  EXPECT_TRUE(eventually([&] { return registry_->get(mark).has_value() && alive_session() != 0; }));
  EXPECT_TRUE(comes_to(DriverState::active));
  EXPECT_EQ(record(), before) << "it runs as it did";
  EXPECT_EQ(host_process(), host);

  const auto freeze = discovery::decode_freeze(registry_->get(mark)->data, mark);
  discovery::put(*registry_, paths_.orders("gw"_gateway), encode(discovery::Adoption{freeze.token, 1}));
  EXPECT_TRUE(eventually([&] { return !record(); })) << "that nothing is ordered is meant";
  EXPECT_TRUE(eventually([&] { return !registry_->get(mark); }));
}

TEST_F(DaemonTest, OneThatReturnsAfterAnotherGatewayTookItsPlaceEndsWithAnErrorAndItsHostsWithIt) {
  configure(TEST_PLUGINS, quick_);
  const int host = start_with_host();
  ASSERT_GT(host, 0);
  const pid_t cut_off = daemon_;
  kill(cut_off, SIGSTOP);
  EXPECT_GT(start_twin(), 0);
  EXPECT_EQ(kill(host, 0), 0) << "nobody has fenced it yet: its gateway stands still";
  const auto before = seen();
  kill(cut_off, SIGCONT);
  expect_its_end(cut_off, host);
  EXPECT_EQ(seen(), before) << "the other one has the place as before";
  give(false);
  EXPECT_TRUE(comes_to(DriverState::inactive)) << "and follows orders";
}

TEST_F(DaemonTest, OneThatReturnsAfterItWasKilledAndReplacedEndsWithAnErrorAndTheHostsThatItLeft) {
  configure(TEST_PLUGINS, quick_);
  const int host = start_with_host();
  ASSERT_GT(host, 0);
  end_daemon(SIGKILL);
  const int another = start_twin();
  EXPECT_GT(another, 0);
  EXPECT_EQ(kill(host, 0), 0) << "nobody has fenced it yet: its gateway is dead, and it has no lease";
  const auto before = seen();
  const pid_t twin = daemon_;
  start_daemon();
  expect_its_end(std::exchange(daemon_, twin), host);
  EXPECT_EQ(seen(), before) << "the other one has the place as before";
  give(false);
  EXPECT_TRUE(comes_to(DriverState::inactive)) << "and follows orders";
}

TEST_F(DaemonTest, OneThatReturnsAfterItWasKilledAndReplacedHasLeftNoInstanceWithALeaseToRunBesideAnother) {
  const fs::path alone = folder_ / "alone";
  properties_.insert({{"alone", alone}, {"on_partition", "stop"}, {"lease", "6s"}});
  configure(TEST_PLUGINS, quick_);
  const int host = start_with_host();
  ASSERT_GT(host, 0);
  end_daemon(SIGKILL);
  EXPECT_TRUE(eventually([&] {
    const processes::OwnedDescriptor lock(open(alone.c_str(), O_RDONLY | O_CLOEXEC));
    return flock(lock.get(), LOCK_EX | LOCK_NB) == 0;
  })) << "its host does not stop the instance";
  EXPECT_EQ(kill(host, 0), 0) << "the host itself goes on";
  const int another = start_twin();
  EXPECT_GT(another, 0);
  const auto before = seen();
  const pid_t twin = daemon_;
  start_daemon();
  expect_its_end(std::exchange(daemon_, twin), host);
  EXPECT_EQ(seen(), before) << "the other one has the place as before";

  end_daemon(SIGTERM);
  EXPECT_TRUE(eventually([&] { return alive_session() == 0; })) << "the place is not free";
  const int again = start_with_host();
  EXPECT_GT(again, 0);
  std::vector<std::string> lines;
  std::ifstream file(alone);
  for (std::string line; std::getline(file, line);) {
    if (lines.empty() || lines.back() != line) lines.push_back(line);  // a busy machine may renew a lease late
  }
  EXPECT_THAT(lines, testing::ElementsAre(std::to_string(host), std::to_string(another), std::to_string(again)));
}

TEST_F(DaemonTest, TrustedKeysThatComeAndGoCountByThemselves) {
  const auto lab = security::new_key_pair(), anna = security::new_key_pair();
  const auto write = [&](const fs::path& name, const std::string& bytes) {
    std::ofstream(folder_ / name, std::ios::binary) << bytes;
  };
  fs::create_directory(folder_ / "keys");
  write("keys/lab.pub", lab.public_pem);
  fs::create_directory(folder_ / "plugins");
  std::ifstream file(fs::path(TEST_PLUGINS) / "probe.so", std::ios::binary);
  const std::string probe(std::istreambuf_iterator<char>(file), {});
  for (const auto& [name, key] : {std::pair("of-lab.so", &lab), std::pair("of-anna.so", &anna)}) {
    write(fs::path("plugins") / name, probe);
    write(fs::path("plugins") / (std::string(name) + ".sig"), security::sign(key->private_pem, "key", probe));
  }
  properties_["isolation"] = "instance";  // each starts a host
  configure(folder_ / "plugins",
            "plugins.require_signature: true\nplugins.trusted_keys: [" + (folder_ / "keys").string() + "]\n");
  start_daemon();
  give(true, "a", "of-lab.so");
  ASSERT_TRUE(comes_to(DriverState::active));
  EXPECT_EQ(record()->signed_by, "lab");
  give(true, "b", "of-anna.so");
  ASSERT_TRUE(comes_to(DriverState::failed, "b"));

  fs::remove(folder_ / "keys/lab.pub");
  write("keys/anna.pub", anna.public_pem);
  int number = 0;
  ASSERT_TRUE(eventually([&] {  // when it has read them
    const auto instance = "c" + std::to_string(++number);
    give(true, instance, "of-anna.so");
    return eventually([&] {
             const auto now = record(instance);
             return now && (now->state == DriverState::active || now->state == DriverState::failed);
           }) &&
           record(instance)->state == DriverState::active;
  }));
  EXPECT_EQ(record("c" + std::to_string(number))->signed_by, "anna");
  give(true, "d", "of-lab.so");
  ASSERT_TRUE(comes_to(DriverState::failed, "d"));
  EXPECT_THAT(record("d")->reason, testing::HasSubstr("a key that is trusted here"));
  EXPECT_EQ(record()->state, DriverState::active) << "what runs goes on";
}

TEST_F(DaemonTest, ABrokersFileThatIsReplacedComesToConfinedHostsByItself) {
  const fs::path password = tests::write_file(folder_ / "password", "sesame"), copies = folder_ / "state/broker-files";
  configure(TEST_PLUGINS, "host_files: {read: [], write: []}\n");
  const std::string file = folder_ / "gateway.yaml";
  std::string text = tests::read_file(file);
  const std::string urls = "rabbitmq: {";
  text.replace(text.find(urls), urls.size(), urls + "user: u, password_file: " + password.string() + ", ");
  tests::write_file(file, text);
  const auto hosts_read = [&](const std::string& bytes) {
    return eventually([&] {
      std::error_code none;
      fs::directory_iterator copy(copies, none);
      return copy != fs::directory_iterator() && tests::read_file(copy->path()) == bytes;
    });
  };
  start_daemon();
  ASSERT_TRUE(hosts_read("sesame"));
  config::replace_file(password, "open sesame", 0600);
  EXPECT_TRUE(hosts_read("open sesame"));
}

TEST_F(DaemonTest, WhatCannotBeReadAgainOnSighupKeepsNothingElseFromBeingRead) {
  const auto keys = security::new_key_pair();
  fs::create_directory(folder_ / "keys");
  std::ofstream(folder_ / "keys/lab.pub", std::ios::binary) << keys.public_pem;
  configure(TEST_PLUGINS, "plugins.trusted_keys: [" + (folder_ / "keys").string() +
                              "]\naudit: {file: " + (folder_ / "audit.log").string() + "}\n");
  start_daemon();
  ASSERT_TRUE(eventually([&] { return fs::exists(folder_ / "audit.log"); }));
  fs::rename(folder_ / "audit.log", folder_ / "audit.log.1");
  std::ofstream(folder_ / "keys/broken.pub") << "no key";
  kill(daemon_, SIGHUP);
  EXPECT_TRUE(eventually([&] { return fs::exists(folder_ / "audit.log"); })) << "its audit log is begun anew";
}

TEST_F(DaemonTest, WhatAGatewayWasAboutToDoWhenItWasKilledStandsInItsAuditLog) {
  const std::string log = folder_ / "audit.log";
  configure(TEST_PLUGINS, "audit: {file: " + log + "}\n");
  const auto count = [&](const std::string& event) {
    const std::string text = tests::read_file(log);
    std::size_t found = 0;
    for (auto at = text.find(event); at != std::string::npos; at = text.find(event, at + 1)) ++found;
    return found;
  };
  const int port = tests::free_port();
  const std::string file = folder_ / "gateway.yaml";
  std::string text = tests::read_file(file);
  text.replace(text.find("port: 0"), 7, "port: " + std::to_string(port));
  std::ofstream(file) << text;
  start_daemon();
  ASSERT_TRUE(eventually([&] { return alive_session() != 0; }));
  const auto session = alive_session();
  ASSERT_TRUE(eventually([&] { return registry_->get(paths_.orders("gw"_gateway)).has_value(); })) << "it takes orders";

  zookeeper_.command("pause", "PAUSED");  // the order's effect is a node there
  auto answer = std::async(std::launch::async, [&] { return deploy_at(port); });
  EXPECT_TRUE(eventually([&] { return count(R"("event":"begun")") == 1; })) << "it is written down after its effect";
  end_daemon(SIGKILL);
  EXPECT_EQ(answer.get(), std::nullopt) << "the caller does not know what became of it";
  zookeeper_.command("resume", "RESUMED");
  const auto orders = registry_->children(paths_.orders("gw"_gateway));
  EXPECT_TRUE(!orders || orders->empty()) << "nothing came of it";
  EXPECT_THAT(tests::read_file(log), testing::HasSubstr("deploySensor"));
  EXPECT_EQ(count(R"("event":"ended")"), 0U);

  start_daemon();
  ASSERT_TRUE(eventually([&] { return alive_session() != 0 && alive_session() != session; }));
  // The gateway refuses orders until it has taken its id over.
  EXPECT_TRUE(eventually([&] { return deploy_at(port) == DriverState::active; }));
  EXPECT_GE(count(R"("event":"ended")"), 1U);
  EXPECT_TRUE(eventually([&] { return count(R"("event":"begun")") == count(R"("event":"ended")") + 1; }))
      << "all but the first one ended";
  EXPECT_TRUE(security::verify_audit({log}, {}).findings.empty()) << "the chain goes on over the gateway's death";
}

}  // namespace
}  // namespace iotcloud::gateway
