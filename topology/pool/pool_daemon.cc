#include <atomic>
#include <optional>
#include <utility>

#include <unistd.h>

#include <iotcloud/config/daemon/reload.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/processes/state_folder.h>
#include <iotcloud/rpc/http/metrics_endpoint.h>
#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/pool_config.h>
#include <iotcloud/topology/pool/pool_daemon.h>

namespace iotcloud::topology {

namespace {

/// The daemon's parts, in the order in which they depend on each other.
class PoolDaemon final : public config::DaemonService {
 public:
  explicit PoolDaemon(PoolConfig config) : config_(std::move(config)) {}

  void start(const std::stop_token& stop) override {
    state_.emplace(config_.workers.state_dir);
    config_.workers.state_dir = config_.service.state_folder = state_->path();
    processes::PluginStore::Options store;
    store.folder = state_->path() + "/libraries";
    store.most_bytes = config_.upload_limit;
    store.limit_key = "libraries.upload_limit_mb";
    store.trust = config_.library_keys;
    const auto libraries = std::make_shared<processes::PluginStore>(store);
    config_.workers.store = config_.service.libraries = config_.pool.libraries = libraries;
    config_.service.on_library = [this] {
      if (running_) pool_->take_library();
    };
    registry_ = discovery::make_registry(config_.registry);
    // The ports are opened before the pool registers: a pool that cannot have them does not start.
    service_.emplace(config_.service);
    auto options = config_.pool;
    options.registry = registry_.get();
    options.record.state_id = state_->id();
    options.record.since_ms = config::system_clock().wall_ms();
    if (options.record.port == 0) options.record.port = service_->port();
    options.launcher = std::make_shared<WorkerProcesses>(config_.workers);
    pool_.emplace(std::move(options));
    if (!config_.pages.address.empty())
      metrics_.emplace(config_.pages, config::process_metrics(), [this] { return trouble(); });
    pool_->start(stop);
    running_ = true;
  }

  void reload() override {
    config::Reload parts;
    parts.part([&] { config_.library_keys->reload(); });
    if (config_.order_keys) parts.part([&] { config_.order_keys->reload(); });
    parts.part([&] { service_->reload(); });
    if (metrics_) parts.part([&] { metrics_->reload(); });
    parts.finish();
  }

  void stop(std::chrono::milliseconds limit) override {
    running_ = false;
    metrics_.reset();
    service_.reset();
    pool_->stop(limit - reserve);
    pool_.reset();
    registry_.reset();
  }

  std::string trouble() const override { return pool_->trouble(); }

 private:
  static constexpr std::chrono::milliseconds reserve{300};

  PoolConfig config_;
  std::optional<processes::StateFolder> state_;
  std::unique_ptr<discovery::Registry> registry_;
  std::optional<Pool> pool_;
  std::atomic<bool> running_{false};
  std::optional<PoolService> service_;           ///< after the pool, which it tells of libraries
  std::optional<rpc::MetricsEndpoint> metrics_;  ///< last: its thread asks the others, also when start() fails
};

}  // namespace

std::unique_ptr<config::DaemonService> make_pool_daemon(const std::string& config_file) {
  return std::make_unique<PoolDaemon>(PoolConfig::load(config_file));
}

}  // namespace iotcloud::topology
