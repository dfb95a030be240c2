// The daemon iotcloud-gateway with a real registry: what its driver hosts go through when it dies.
#include <chrono>
#include <filesystem>
#include <fstream>
#include <optional>

#include <gmock/gmock.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/gateway/host/control/unix_socket.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>
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
    std::ofstream(folder_ / "gateway.yaml")
        << "id: gw\nregistry: \"" << zookeeper_.url() << "\"\nthrift: {port: 0}\nplugins: " << TEST_PLUGINS
        << "\nstate: " << (folder_ / "state").string() << "\nbrokers: {rabbitmq: {urls: [\"amqp://127.0.0.1:1/\"]}}\n";
    discovery::RegistryOptions options;
    options.url = zookeeper_.url();
    registry_ = discovery::make_registry(options);
  }
  ~DaemonTest() override {
    if (daemon_ > 0) end_daemon(SIGKILL);
    if (const int host = host_process(); host > 0) kill(host, SIGKILL);
    fs::remove_all(folder_);
  }

  void start_daemon() {
    const std::string program = GATEWAY_PROGRAM;
    const std::string config = folder_ / "gateway.yaml";
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

  void give(bool active) {
    discovery::OrderRecord order;
    order.instance = "a";
    order.plugin = "probe.so";
    order.active = active;
    order.properties = {{"channels", "none"}};
    discovery::put(*registry_, paths_.order("gw", "a"), encode(order));
  }
  std::optional<discovery::DriverRecord> record() {
    const auto path = paths_.instance("probe", "a");
    const auto node = registry_->get(path);
    if (!node) return std::nullopt;
    return discovery::decode_driver(node->data, path);
  }
  bool comes_to(DriverState state) {
    return eventually([&] {
      const auto now = record();
      return now && now->state == state;
    });
  }
  int host_process() const {
    std::error_code none;
    for (const auto& file : fs::directory_iterator(folder_ / "state", none)) {
      if (file.path().extension() == ".sock")
        return peer_process(connect_in(folder_ / "state", file.path().filename()));
    }
    return 0;
  }
  /// The session that holds the gateway's ephemeral node; 0: there is no such node.
  std::int64_t alive_session() {
    const auto node = registry_->get(paths_.gateway_alive("gw"));
    return node ? node->owner_session : 0;
  }

  tests::PrivateServer zookeeper_{"zookeeper.py"};
  const discovery::Paths paths_;
  std::unique_ptr<discovery::Registry> registry_;
  fs::path folder_;
  pid_t daemon_ = 0;
};

TEST_F(DaemonTest, AHostOutlivesAGatewayThatIsKilledAndIsAdoptedWhenItReturns) {
  start_daemon();
  give(true);
  ASSERT_TRUE(comes_to(DriverState::active));
  const int host = host_process();
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
  EXPECT_EQ(alive_session(), 0);
}

TEST_F(DaemonTest, ItWaitsForARegistryThatIsAwayAndWorksWhenItComes) {
  zookeeper_.kill();
  start_daemon();
  zookeeper_.start();
  give(true);
  EXPECT_TRUE(comes_to(DriverState::active));
}

}  // namespace
}  // namespace iotcloud::gateway
