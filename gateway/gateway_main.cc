// iotcloud-gateway: connects the devices of one place to the brokers, by way of driver hosts.
#include <atomic>
#include <cstdlib>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <fmt/chrono.h>
#include <signal.h>
#include <unistd.h>

#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/config/daemon/reload.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/gateway_config.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/processes/state_folder.h>
#include <iotcloud/rpc/http/metrics_endpoint.h>
#include <iotcloud/security/certificate_days.h>

namespace {

using namespace iotcloud;

/// Another process has this gateway's place in the registry.
std::atomic<bool> replaced{false};

/// The daemon's parts, in the order in which they depend on each other.
class GatewayDaemon final : public config::DaemonService {
 public:
  explicit GatewayDaemon(gateway::GatewayConfig config) : config_(std::move(config)) {}

  void start(const std::stop_token& stop) override {
    state_.emplace(config_.hosts.state_dir);
    config_.hosts.state_dir = state_->path();
    config_.thrift.log_folder = gateway::ProcessLauncher::log_folder(state_->path());
    if (geteuid() == 0 && config_.hosts.confinement.user.empty()) {
      gateway::logger.warn(
          "this gateway runs as root, and so does every driver: name a user with no rights in host_user, as which its "
          "driver hosts are to run");
    }
    processes::PluginStore::Options plugins;
    plugins.folder = state_->path() + "/plugins";
    plugins.most_bytes = config_.plugin_upload_limit;
    plugins.trust = config_.hosts.trust;
    config_.hosts.store = std::make_shared<processes::PluginStore>(plugins);
    config_.hosts.metrics = std::make_shared<gateway::HostMetrics>();
    of_hosts_ = config::process_metrics().add_source(
        [hosts = config_.hosts.metrics](std::vector<config::Sample>& samples) { hosts->append(samples); });
    std::map<std::string, std::string> certificates;
    for (const auto& broker : config_.gateway.brokers) certificates[broker.name] = broker.options.tls.certificate_file;
    certificate_days_.emplace(security::certificates_for_brokers(certificates), config::process_metrics());
    registry_ = discovery::make_registry(config_.registry);
    auto options = config_.gateway;
    options.registry = registry_.get();
    options.state_id = state_->id();
    options.history_file = state_->path() + "/history.jsonl";
    options.followed_file = state_->path() + "/followed-orders.jsonl";
    options.provisioned_file = state_->path() + "/provisioned.jsonl";
    config_.hosts.brokers = std::make_shared<gateway::HostBrokers>();
    config_.hosts.troubles = std::make_shared<gateway::HostTroubles>();
    launcher_ = std::make_shared<gateway::ProcessLauncher>(config_.hosts);
    options.launcher = launcher_;
    options.plugins = config_.hosts.store;
    options.on_replaced = [](const std::string&) {  // it has said why in the log
      replaced = true;
      kill(getpid(), SIGTERM);
    };
    if (!config_.audit.file.empty()) options.audit = std::make_shared<security::AuditLog>(config_.audit);
    config_.thrift.audit = options.audit;
    gateway_.emplace(std::move(options));
    // The ports are opened before the gateway registers: a gateway that cannot have them leaves no record in the
    // registry, which would show it as lost for ever.
    service_.emplace(config_.thrift, *gateway_, *registry_, config_.gateway.paths);
    if (!config_.pages.address.empty())
      metrics_.emplace(config_.pages, config::process_metrics(), [this] { return trouble(); });
    gateway_->start(stop);
    watching_ = std::jthread([this](const std::stop_token& end) { watch_brokers(end); });
  }

  void reload() override {
    config::Reload parts;
    parts.part([&] { config_.trust->reload(); });
    if (config_.order_keys) parts.part([&] { config_.order_keys->reload(); });
    parts.part([&] { service_->reload(); });
    if (!config_.provisioning_file.empty())
      parts.part([&] { gateway_->set_rules(gateway::ProvisioningRules::load(config_.provisioning_file)); });
    if (metrics_) parts.part([&] { metrics_->reload(); });
    parts.finish();
  }

  void stop(std::chrono::milliseconds limit) override {
    watching_ = {};
    metrics_.reset();
    gateway_->stop(limit - thrift_share);
    service_.reset();
    gateway_.reset();
    registry_.reset();
  }

  std::string trouble() const override {
    if (registry_->session() != discovery::SessionState::connected) return "the registry is away";
    const std::string text = gateway_->trouble();
    return text.empty() ? config_.hosts.brokers->trouble(config::system_clock().now()) : text;
  }

 private:
  static constexpr std::chrono::milliseconds thrift_share{500};
  static constexpr std::chrono::milliseconds look_pause{250};

  /// Shows in the gateway's record which brokers its drivers cannot reach, and which instances hang or lose messages,
  /// and since when, for `iotcloud gateways` and the console; and gives confined hosts the brokers' files that were
  /// replaced.
  void watch_brokers(const std::stop_token& stop) {
    config::Mutex mutex;
    config::StoppableConditionVariable end;
    std::string shown;
    const config::MutexLock lock(mutex);
    while (!end.wait_for(mutex, stop, look_pause, [&] { return stop.stop_requested(); })) {
      std::string trouble = config_.hosts.brokers->trouble(config::system_clock().now());
      const std::string of_instances = config_.hosts.troubles->trouble();
      if (!of_instances.empty()) trouble += (trouble.empty() ? "" : "; ") + of_instances;
      if (trouble != std::exchange(shown, trouble)) gateway_->show_trouble(trouble);
      launcher_->renew_broker_files();
    }
  }

  gateway::GatewayConfig config_;
  config::Metrics::SourceRegistration of_hosts_;
  std::optional<security::CertificateDays> certificate_days_;  ///< of those that driver hosts show to brokers
  std::optional<processes::StateFolder> state_;
  std::unique_ptr<discovery::Registry> registry_;
  std::shared_ptr<gateway::ProcessLauncher> launcher_;
  std::optional<gateway::Gateway> gateway_;
  std::optional<gateway::SiteService> service_;
  std::jthread watching_;                        ///< watch_brokers()
  std::optional<rpc::MetricsEndpoint> metrics_;  ///< last: its thread asks the others, also when start() fails
};

}  // namespace

int main(int argc, char** argv) {
  config::DaemonOptions options;
  options.name = "iotcloud-gateway";
  options.description = "Runs drivers, connects them to the brokers, and follows the gateway master's orders.";
  options.build = [](const std::string& file) {
    return std::make_unique<GatewayDaemon>(gateway::GatewayConfig::load(file));
  };
  const int status = config::run_daemon(argc, argv, options);
  return replaced ? EXIT_FAILURE : status;
}
