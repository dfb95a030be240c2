#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <mutex>
#include <thread>

#include <fmt/format.h>
#include <unistd.h>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/config/log.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/topology/definition/describe.h>
#include <iotcloud/topology/endpoints/endpoints.h>
#include <iotcloud/topology/worker/check.h>
#include <iotcloud/topology/worker/control.h>
#include <iotcloud/topology/worker/worker.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.worker"};

/// Left for leaving the registry and closing brokers when a stop has a limit.
constexpr std::chrono::milliseconds reserve{700};

/// For closing the topology after a kill's drain; what hangs in user code is left.
constexpr std::chrono::milliseconds after_drain{3000};

std::string host_name() {
  char host[256] = "host";
  static_cast<void>(gethostname(host, sizeof host - 1));
  return host;
}

/// A broker cuts a silent client off after two heartbeats at least, and has heard of it one heartbeat ago at most.
std::chrono::milliseconds longest_standstill(const EndpointServices& services) {
  auto shortest = services.other_brokers.heartbeat;
  for (const auto& [name, options] : services.broker_options) shortest = std::min(shortest, options.heartbeat);
  return shortest;
}

std::string unique_name() {
  return fmt::format("{}-{}-{}", host_name(), getpid(), discovery::new_instance_id().substr(0, 8));
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
  runtime.births = true;  // for the fence
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
    services->broker_options = definition.brokers;
    services->other_brokers.heartbeat = brokers::usual_heartbeat(definition.registry.session_timeout);
    services->clock = options.clock != nullptr ? options.clock : &config::system_clock();
    services->metrics = options.metrics != nullptr ? options.metrics : &config::process_metrics();
    if (options.fence) {
      services->fence = options.fence;
    } else if (services->clock == &config::system_clock()) {
      standstill = longest_standstill(*services);
      services->fence = std::make_shared<Fence>(*services->clock, standstill);
    }
    services->brokers = std::make_shared<brokers::BrokerPool>(options.clock, services->metrics);
    topology = assemble(definition, options.components, endpoint_factories(services));
    if (options.registry == nullptr && definition.registry.url.empty()) {
      throw definition.root.error("", "the key \"zk.servers\" is missing",
                                  "add \"zk.servers: [\\\"host:2181\\\"]\", or \"registry: embedded://NAME\"");
    }
  }

  void start() {
    if (options.registry == nullptr) {
      own_registry = discovery::make_registry(options.definition.registry);
      options.registry = own_registry.get();
    }
    services->registry = options.registry;
    if (standstill.count() > 0) heart = std::jthread([this](const std::stop_token& stop) { beat(stop); });
    if (const std::string crossed = crossings(options.definition, topology); !crossed.empty()) stay_alone(crossed);
    runtime = std::make_unique<Runtime>(topology, runtime_options(options));
    taps = std::make_unique<TapDesk>(*runtime, TapDesk::Options{.clock = options.clock});
    runtime->deactivate();  // until the control knows that no order says so
    runtime->start();
    running = true;
    control = std::make_unique<WorkerControl>(control_options());
    control->start();
    logger.info("topology {} runs as worker {}", topology.name, services->worker);
  }

  void beat(const std::stop_token& stop) {
    std::mutex mutex;
    std::condition_variable_any end;
    std::unique_lock lock(mutex);
    do {
      services->fence->beat();
    } while (!end.wait_for(lock, stop, standstill / 4, [&] { return stop.stop_requested(); }));
  }

  /// Holds the place of the topology's only worker. One that was killed keeps it until its session is over.
  void stay_alone(const std::string& crossed) {
    const std::string path = services->paths.topology(topology.name) + "/alone";
    const auto patience = options.definition.registry.session_timeout + std::chrono::seconds(2);
    const auto deadline = std::chrono::steady_clock::now() + patience;
    for (;;) {
      try {
        alone = options.registry->hold(path, services->worker);
        return;
      } catch (const discovery::RegistryError& error) {
        if (error.code() == discovery::RegistryErrorCode::away) {
          logger.warn("topology {}: the registry is away, so that nobody knows whether another worker runs",
                      topology.name);
          alone = options.registry->hold_eventually(path, services->worker);
          return;
        }
        if (error.code() != discovery::RegistryErrorCode::exists) throw;
      }
      if (std::chrono::steady_clock::now() >= deadline) {
        throw options.definition.root.error(
            "topology.name",
            "another worker runs topology \"" + topology.name +
                "\", and these inputs reach across drivers, of which each worker would have only its share:\n" +
                crossed,
            "where each worker for itself is meant, say \"scope: worker\" of these bolts (or \"topology.scope: "
            "worker\"); otherwise run one worker, or use a key with driverID");
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
  }

  WorkerControl::Options control_options() {
    WorkerControl::Options control_options;
    control_options.services = services;
    control_options.runtime = runtime.get();
    control_options.topology.name = topology.name;
    control_options.topology.since_ms = services->clock->wall_ms();
    for (const auto& component : topology.components) {
      auto& kind = component.spout ? control_options.topology.spouts : control_options.topology.bolts;
      kind.push_back(component.id);
    }
    control_options.worker.name = services->worker;
    control_options.worker.host = host_name();
    control_options.worker.pid = getpid();
    control_options.worker.http = http_address;
    control_options.worker.since_ms = control_options.topology.since_ms;
    control_options.on_killed = [this] {
      finish(after_drain);
      if (options.on_killed) options.on_killed();
    };
    return control_options;
  }

  void stop(std::chrono::milliseconds limit) {
    if (!runtime) return;
    if (control) control->end();
    finish(limit);
  }

  /// The end of the topology and of its place in the registry; once.
  void finish(std::chrono::milliseconds limit) {
    const std::lock_guard lock(finish_mutex);
    if (std::exchange(finished, true)) return;
    for (const auto& prepare : services->before_stop) prepare();
    const auto drain = std::max(limit - reserve, limit / 2);
    if (!runtime->stop(drain))
      logger.warn("topology {}: not everything was done within {} ms", topology.name, drain.count());
    alone.reset();
    if (control) control->leave();
    for (const auto& clear_up : services->after_stop) clear_up();
    heart = {};
  }

  WorkerOptions options;
  const EndpointServicesPtr services;
  Topology topology;
  std::chrono::milliseconds standstill{0};  ///< of the fence; 0: none
  std::unique_ptr<discovery::Registry> own_registry;
  discovery::GuardPtr alone;  ///< the place of the only worker, where one alone may run
  std::string http_address;   ///< constant after start()
  std::unique_ptr<Runtime> runtime;
  std::unique_ptr<TapDesk> taps;
  std::atomic<bool> running{false};  ///< runtime and taps are there
  std::mutex finish_mutex;
  bool finished = false;                   ///< guarded by finish_mutex
  std::unique_ptr<WorkerControl> control;  ///< goes before the runtime, which it uses
  std::jthread heart;                      ///< tells the fence that this process runs
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

std::string Worker::trouble() const {
  return impl_->options.registry->session() == discovery::SessionState::connected ? "" : "the registry is away";
}

void Worker::show_http_address(std::string address) {
  impl_->http_address = std::move(address);
}

const std::string& Worker::name() const {
  return impl_->services->worker;
}

std::string Worker::describe() const {
  if (!impl_->running) throw config::Error("the worker is starting; ask again in a moment");
  return topology::describe(*impl_->runtime, impl_->services->worker);
}

TapDesk& Worker::taps() {
  if (!impl_->running) throw config::Error("the worker is starting; ask again in a moment");
  return *impl_->taps;
}

Snapshot Worker::snapshot() const {
  return impl_->runtime ? impl_->runtime->snapshot() : Snapshot{};
}

}  // namespace iotcloud::topology
