#include <atomic>
#include <thread>

#include <iotcloud/config/log.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/fleet/in_process_launcher.h>
#include <iotcloud/gateway/gateway.h>
#include <iotcloud/topology/local/local_cluster.h>

namespace iotcloud::local {

namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds for_gateways{
    2000};  ///< the part of the time to stop that workers leave to gateways
const config::Logger logger{"local"};

std::unique_ptr<discovery::Registry> connect(const LocalOptions& options) {
  discovery::RegistryOptions registry;
  registry.url = options.registry_url.empty() ? "embedded://" + options.name : options.registry_url;
  return discovery::make_registry(registry);
}

/// Removes a cluster's own part of the registry when all that wrote there is gone.
class OwnRoot {
 public:
  /// \param path empty: there is none. \param registry outlives this.
  OwnRoot(discovery::Registry& registry, std::string path) : registry_(registry), path_(std::move(path)) {}
  ~OwnRoot() {
    if (path_.empty()) return;
    try {
      discovery::remove_tree(registry_, path_);
    } catch (const std::exception& error) {
      logger.error("{} stays in the registry: {}; remove it by hand", path_, error.what());
    }
  }
  OwnRoot(const OwnRoot&) = delete;
  OwnRoot& operator=(const OwnRoot&) = delete;

 private:
  discovery::Registry& registry_;
  const std::string path_;
};

}  // namespace

struct LocalCluster::Impl {
  explicit Impl(LocalOptions given)
      : options(std::move(given)),
        paths(options.own_root.empty() ? discovery::Paths() : discovery::Paths(options.own_root + "/sensors")),
        registry(connect(options)),
        own_root(*registry, options.own_root) {
    master = std::make_unique<master::Master>(*registry, master_options());
    gateway::InProcessLauncher::Options launching;
    launching.plugin_dir = options.plugin_dir;
    launching.linked_in = options.drivers;
    launching.clock = options.clock;
    launching.metrics = options.metrics;
    const auto launcher = std::make_shared<gateway::InProcessLauncher>(launching);
    for (const auto& id : options.gateways) {
      gateway::GatewayOptions gateway;
      gateway.id = id;
      gateway.brokers = brokers();
      gateway.registry = registry.get();
      gateway.paths = paths;
      gateway.launcher = launcher;
      gateway.state_id = discovery::new_instance_id();
      gateway.clock = options.clock;
      gateways.push_back(std::make_unique<gateway::Gateway>(std::move(gateway)));
      gateways.back()->start();
    }
    wait_for_leadership();
  }

  master::MasterOptions master_options() const {
    master::MasterOptions settings;
    settings.id = options.name;
    settings.paths = paths;
    return settings;
  }

  std::vector<brokers::BrokerSetting> brokers() const {
    std::vector<brokers::BrokerSetting> settings;
    for (const auto& [name, given] : options.brokers) {
      const std::string url = given.empty() ? "embedded://" + options.name : given;
      brokers::BrokerOptions how;
      how.urls = {url};
      settings.push_back({name, brokers::broker_kind(url), std::move(how)});
    }
    return settings;
  }

  void wait_for_leadership() {
    const auto deadline = Clock::now() + std::chrono::seconds(10);
    while (!master->status().leading) {
      if (Clock::now() > deadline) {
        throw config::Error("the master of the local cluster \"" + options.name +
                            "\" was not elected within 10 s; check that its registry can be reached");
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }

  topology::Worker& run(topology::TopologyDefinition definition, topology::ComponentRegistry components) {
    topology::WorkerOptions worker{.definition = std::move(definition),
                                   .components = std::move(components),
                                   .library_folders = options.library_folders,
                                   .registry = registry.get(),
                                   .clock = options.clock,
                                   .metrics = options.metrics};
    worker.definition.zk_root = paths.sensors;
    if (!options.plugin_dir.empty()) worker.library_folders.push_back(options.plugin_dir);
    auto started = std::make_unique<topology::Worker>(std::move(worker));
    started->start();
    const config::MutexLock lock(mutex);
    workers.push_back(std::move(started));
    return *workers.back();
  }

  discovery::InstanceId deploy(const std::string& plugin, const std::map<std::string, std::string>& properties,
                               const discovery::GatewayId& gateway) {
    master::DeployRequest request;
    request.plugin = plugin;
    request.properties = properties;
    request.gateways = {gateway.empty() ? options.gateways.at(0) : gateway};
    return done("deploy " + plugin, master->deploy(request));
  }

  /// The instance that an order with one outcome is about. \throws config::Error unless the order was done.
  static discovery::InstanceId done(const std::string& order, const master::OrderResult& result) {
    if (!result.all_done() || result.outcomes.size() != 1) {
      throw config::Error(order + ": " + (result.text.empty() ? result.summary() : result.text));
    }
    return result.outcomes.front().instance;
  }

  /// Undeploys all drivers, so that nothing of them stays at a broker either. What is not done in time is let be.
  void undeploy_all(std::chrono::milliseconds limit) {
    try {
      master::InstanceSelection all;
      for (const auto& placed : master->orders()) all.instances.push_back(placed.order.instance);
      if (all.instances.empty()) return;
      all.wait = limit;
      const auto result = master->undeploy(all);
      if (!result.all_done()) logger.warn("the drivers were not all undeployed: {}", result.summary());
    } catch (const std::exception& error) {
      logger.warn("the drivers were not undeployed: {}", error.what());
    }
  }

  bool stop(std::chrono::milliseconds limit) {
    const config::MutexLock lock(mutex);
    if (stopped) return in_time;
    stopped = true;
    const auto deadline = Clock::now() + limit;
    const auto left = [&] {
      return std::max(std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Clock::now()),
                      std::chrono::milliseconds(100));
    };
    const auto part = [&](const char* what, config::DaemonService& service, std::chrono::milliseconds kept) {
      try {
        service.stop(std::max(left() - kept, std::chrono::milliseconds(100)));
      } catch (const std::exception& error) {
        logger.error("a {} did not stop in order: {}", what, error.what());
        in_time = false;
      }
    };
    // Workers do not get all of the time: a window keeps its tuples for as long as its worker may wait, and the drivers
    // then need time to send what they have published.
    for (auto& worker : workers) part("worker", *worker, std::min(limit / 2, for_gateways));
    if (!options.own_root.empty()) undeploy_all(left() / 2);
    for (auto& gateway : gateways) part("gateway", *gateway, std::chrono::milliseconds(0));
    master->close();
    in_time = in_time && Clock::now() <= deadline;
    return in_time;
  }

  const LocalOptions options;
  const discovery::Paths paths;
  std::unique_ptr<discovery::Registry> registry;
  const OwnRoot own_root;  ///< after the registry, and before all that writes there: it goes when they are gone
  std::unique_ptr<master::Master> master;
  std::vector<std::unique_ptr<gateway::Gateway>> gateways;
  config::Mutex mutex;
  std::vector<std::unique_ptr<topology::Worker>> workers IOTCLOUD_GUARDED_BY(mutex);
  bool stopped IOTCLOUD_GUARDED_BY(mutex) = false;
  bool in_time IOTCLOUD_GUARDED_BY(mutex) = true;
};

LocalCluster::LocalCluster(LocalOptions options) : impl_(std::make_unique<Impl>(std::move(options))) {}

LocalCluster::~LocalCluster() {
  impl_->stop(std::chrono::seconds(5));
}

topology::Worker& LocalCluster::run_topology(const std::string& yaml_file, topology::ComponentRegistry components) {
  return impl_->run(topology::TopologyDefinition::load(yaml_file), std::move(components));
}

topology::Worker& LocalCluster::run_topology(topology::TopologyDefinition definition,
                                             topology::ComponentRegistry components) {
  return impl_->run(std::move(definition), std::move(components));
}

discovery::InstanceId LocalCluster::deploy(const std::string& plugin,
                                           const std::map<std::string, std::string>& properties,
                                           const discovery::GatewayId& gateway) {
  return impl_->deploy(plugin, properties, gateway);
}

void LocalCluster::undeploy(const discovery::InstanceId& instance) {
  master::InstanceSelection selection;
  selection.instances = {instance};
  Impl::done("undeploy " + instance, impl_->master->undeploy(selection));
}

bool LocalCluster::stop(std::chrono::milliseconds limit) {
  return impl_->stop(limit);
}

master::Master& LocalCluster::master() {
  return *impl_->master;
}

gateway::Gateway* LocalCluster::gateway(const discovery::GatewayId& id) {
  for (const auto& gateway : impl_->gateways)
    if (gateway->id() == id) return gateway.get();
  return nullptr;
}

topology::Worker* LocalCluster::worker(const std::string& name) {
  const config::MutexLock lock(impl_->mutex);
  for (const auto& worker : impl_->workers)
    if (worker->name() == name) return worker.get();
  return nullptr;
}

discovery::Registry& LocalCluster::registry() {
  return *impl_->registry;
}

const discovery::Paths& LocalCluster::paths() const {
  return impl_->paths;
}

}  // namespace iotcloud::local
