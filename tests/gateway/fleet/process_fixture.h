#pragma once

#include <chrono>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <signal.h>
#include <stdlib.h>

#include <iotcloud/gateway/fleet/process_launcher.h>
#include <iotcloud/processes/unix_socket.h>
#include <iotcloud/tests/gateway/gateway_fixture.h>
#include <iotcloud/tests/gateway/status_log.h>

namespace iotcloud::gateway {

/// A gateway whose driver hosts are real processes, with the tests' plugins in a folder of its own.
class ProcessTest : public GatewayFixture {
 protected:
  ProcessTest() {
    std::string pattern = std::filesystem::temp_directory_path() / "iotcloud-gateway-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    // On purpose longer than the path of a Unix socket may be.
    state_ = folder_ / std::string(120, 's');
    plugins_ = folder_ / "plugins";
    std::filesystem::create_directories(state_);
    std::filesystem::create_directories(plugins_);
    for (const auto* name : {"probe.so", "future_sdk.so", "sick.so"})
      std::filesystem::copy(std::filesystem::path(TEST_PLUGINS) / name, plugins_ / name);
    std::filesystem::copy(std::filesystem::path(TEST_PLUGINS) / "probe.so", plugins_ / "other.so");
  }
  ~ProcessTest() override {
    gateway_.reset();
    for (const auto& socket : sockets()) {
      const int process = processes::peer_process(processes::connect_in(state_, socket));
      if (process > 0) kill(process, SIGKILL);  // 0: the host has ended; kill(0) would kill this group
    }
    std::filesystem::remove_all(folder_);
  }

  std::shared_ptr<HostLauncher> new_launcher() override {
    ProcessLauncher::Options options;
    options.plugin_dir = plugins_;
    options.state_dir = state_;
    options.host_program = host_program_;
    options.ping_period = std::chrono::milliseconds{20};
    options.hang_limit = hang_limit_;
    options.own_thread_hang_limit = own_thread_hang_limit_;
    options.limits = limits_;
    options.confinement = confinement_;
    options.ports = ports_;
    options.network = network_;
    options.brokers_places = brokers_places_;
    options.broker_files = broker_files_;
    options.starter = starter_;
    options.environment = environment_;
    options.log_limit_mb = 1;
    options.metrics = metrics_;
    options.metrics_period = std::chrono::milliseconds{20};
    launcher_ = std::make_shared<ProcessLauncher>(options);
    return launcher_;
  }

  /// A driver without traffic, because the embedded broker does not reach another process.
  discovery::OrderRecord quiet(const std::string& instance, const std::string& plugin = "probe.so",
                               std::map<std::string, std::string> properties = {}) const {
    properties["channels"] = "none";
    auto wanted = order(instance, std::move(properties));
    wanted.plugin = plugin;
    wanted.driver = discovery::DriverName(plugin.substr(0, plugin.find('.')));
    return wanted;
  }

  std::vector<std::string> sockets() const {
    std::vector<std::string> names;
    for (const auto& file : std::filesystem::directory_iterator(state_)) {
      if (file.path().extension() == ".sock") names.push_back(file.path().filename());
    }
    return names;
  }
  /// The process id of the only driver host; 0 if there is none.
  int host_process() const {
    const auto names = sockets();
    return names.size() == 1 ? processes::peer_process(processes::connect_in(state_, names.front())) : 0;
  }
  /// Starts a host with the active instance "a", whose gateway then ends. \param ca the authority of its broker.
  /// \return the host's process; 0 if there is none
  int host_without_gateway(const std::string& ca = "") {
    StatusLog log;
    const auto launcher = new_launcher();
    const auto link = launcher->launch({"probe.so", discovery::GatewayId("gw"), false},
                                       {[&](const auto& status) { log.add(status); }, [](const auto&) {}});
    InstanceSpec spec;
    spec.order = quiet("a");
    spec.brokers = {{"local", "embedded", {}, {"embedded://x"}, {"embedded://x"}}};
    spec.brokers[0].options.tls.ca_file = ca;
    link->create(spec);
    return log.wait_for("a", discovery::DriverState::active) ? host_process() : 0;
  }
  bool has_ended(int process) const {
    return eventually([&] { return kill(process, 0) != 0; });
  }

  std::filesystem::path folder_, state_, plugins_;
  std::chrono::milliseconds hang_limit_{20000}, own_thread_hang_limit_{60000};
  processes::VitalLimits limits_;
  processes::Confinement confinement_;
  ProcessLauncher::Ports ports_;
  processes::PlacesByCode network_;
  std::vector<processes::Place> brokers_places_;
  std::vector<std::string> broker_files_;
  std::shared_ptr<ProcessLauncher> launcher_;  ///< the latest
  std::vector<std::string> environment_;
  std::string starter_, host_program_ = HOST_PROGRAM;
  const std::shared_ptr<HostMetrics> metrics_ = std::make_shared<HostMetrics>();
};

}  // namespace iotcloud::gateway
