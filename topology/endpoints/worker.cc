#include <mutex>

#include <fmt/format.h>
#include <unistd.h>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/topology/endpoints/check.h>
#include <iotcloud/topology/endpoints/endpoints.h>
#include <iotcloud/topology/endpoints/worker.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.worker"};

/// Left for leaving the registry and closing brokers when a stop has a limit.
constexpr std::chrono::milliseconds reserve{700};

std::string unique_name() {
  char host[256] = "host";
  static_cast<void>(gethostname(host, sizeof host - 1));
  return fmt::format("{}-{}-{}", host, getpid(), discovery::new_instance_id().substr(0, 8));
}

RuntimeOptions runtime_options(const WorkerOptions& options) {
  const RunSettings& settings = options.definition.runtime;
  RuntimeOptions runtime;
  if (settings.threads > 0) runtime.threads = static_cast<unsigned>(settings.threads);
  runtime.message_timeout = settings.message_timeout;
  if (settings.max_spout_pending > 0) runtime.max_spout_pending = static_cast<std::size_t>(settings.max_spout_pending);
  runtime.acking = settings.acking;
  if (settings.mailbox_capacity > 0) runtime.mailbox_capacity = static_cast<std::size_t>(settings.mailbox_capacity);
  runtime.clock = options.clock;
  runtime.metrics = options.metrics;
  return runtime;
}

}  // namespace

struct Worker::Impl {
  explicit Impl(WorkerOptions given) : options(std::move(given)), services(std::make_shared<EndpointServices>()) {
    const TopologyDefinition& definition = options.definition;
    load_libraries(definition, options.library_folders, options.components);
    services->topology = definition.name;
    services->worker = unique_name();
    services->paths = discovery::Paths(definition.zk_root);
    services->broker_urls = definition.brokers;
    services->clock = options.clock != nullptr ? options.clock : &config::system_clock();
    services->metrics = options.metrics != nullptr ? options.metrics : &config::process_metrics();
    services->brokers = std::make_shared<BrokerPool>(options.clock, services->metrics);
    topology = assemble(definition, options.components, endpoint_factories(services));
    if (options.registry == nullptr && definition.registry_url.empty()) {
      throw definition.root.error("", "the key \"zk.servers\" is missing",
                                  "add \"zk.servers: [\\\"host:2181\\\"]\", or \"registry: embedded://NAME\"");
    }
  }

  void start() {
    if (options.registry == nullptr) {
      discovery::RegistryOptions registry;
      registry.url = options.definition.registry_url;
      own_registry = discovery::make_registry(registry);
      options.registry = own_registry.get();
    }
    services->registry = options.registry;
    runtime = std::make_unique<Runtime>(topology, runtime_options(options));
    runtime->start();
    appear();
    logger.info("topology {} runs as worker {}", topology.name, services->worker);
  }

  /// Shows the topology and this worker in the registry, now or when it is there.
  void appear() {
    discovery::TopologyRecord record;
    record.name = topology.name;
    record.since_ms = services->clock->wall_ms();
    for (const auto& component : topology.components) {
      (component.spout ? record.spouts : record.bolts).push_back(component.id);
    }
    membership = options.registry->hold_eventually(services->paths.workers(topology.name) + "/" + services->worker, "",
                                                   false, [this, record](const std::string&) { write(record); });
  }

  void write(discovery::TopologyRecord record) {
    const std::string path = services->paths.topology(topology.name);
    try {
      const auto others = options.registry->children(services->paths.workers(topology.name));
      const auto before = options.registry->get(path);
      if (others && others->size() > 1 && before && !before->data.empty()) {
        record.since_ms = discovery::decode_topology(before->data, path).since_ms;  // it runs since the first worker
      }
      discovery::put(*options.registry, path, discovery::encode(record));
    } catch (const config::Error& error) {
      logger.warn("the record of topology {} could not be written: {}", topology.name, error.what());
    }
  }

  void stop(std::chrono::milliseconds limit) {
    if (!runtime || std::exchange(stopped, true)) return;
    for (const auto& prepare : services->before_stop) prepare();
    const auto drain = std::max(limit - reserve, limit / 2);
    if (!runtime->stop(drain))
      logger.warn("topology {}: not everything was done within {} ms", topology.name, drain.count());
    membership.reset();
    disappear();
  }

  /// The last worker takes the topology's record away.
  void disappear() {
    if (options.registry->session() != discovery::SessionState::connected) return;
    auto& registry = *options.registry;
    const std::string path = services->paths.topology(topology.name);
    try {
      registry.remove(services->paths.workers(topology.name));
      discovery::remove_tree(registry, path + "/readers");
      registry.remove(path);
    } catch (const discovery::RegistryError& error) {
      if (error.code() != discovery::RegistryErrorCode::not_empty) {
        logger.warn("the record of topology {} could not be removed: {}", topology.name, error.what());
      }
    }
  }

  WorkerOptions options;
  const EndpointServicesPtr services;
  Topology topology;
  std::unique_ptr<discovery::Registry> own_registry;
  bool stopped = false;
  std::unique_ptr<Runtime> runtime;
  discovery::GuardPtr membership;
};

Worker::Worker(WorkerOptions options) : impl_(std::make_unique<Impl>(std::move(options))) {}

Worker::~Worker() {
  try {
    stop(std::chrono::seconds(5));
  } catch (const std::exception& error) {
    logger.error("the worker did not stop in order: {}", error.what());
  }
}

void Worker::start() {
  impl_->start();
}

void Worker::stop(std::chrono::milliseconds limit) {
  impl_->stop(limit);
}

const std::string& Worker::name() const {
  return impl_->services->worker;
}

Snapshot Worker::snapshot() const {
  return impl_->runtime ? impl_->runtime->snapshot() : Snapshot{};
}

}  // namespace iotcloud::topology
