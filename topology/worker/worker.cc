#include <algorithm>
#include <atomic>
#include <ctime>
#include <map>
#include <string>
#include <thread>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <unistd.h>

#include <iotcloud/brokers/broker_setting.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/name_taken.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/security/certificate_days.h>
#include <iotcloud/security/trusted_keys.h>
#include <iotcloud/topology/definition/describe.h>
#include <iotcloud/topology/endpoints/endpoints.h>
#include <iotcloud/topology/worker/check.h>
#include <iotcloud/topology/worker/control.h>
#include <iotcloud/topology/worker/left_behind.h>
#include <iotcloud/topology/worker/meeting_spouts.h>
#include <iotcloud/topology/worker/worker.h>

namespace iotcloud::topology {

namespace {

const config::Logger worker_logger{"topology.worker"};

/// The part of stop()'s limit that is kept for leaving the registry and closing brokers.
constexpr std::chrono::milliseconds reserve{700};

/// Limit for closing the topology after a kill order's drain; user code that hangs longer is left running.
constexpr std::chrono::milliseconds after_drain{3000};

/// How long a starting worker waits for the registry before it does without.
constexpr std::chrono::milliseconds registry_patience{2000};

/// A call of a component's code that takes so long counts as hanging.
constexpr std::chrono::milliseconds hanging_limit{5000};

/// How often the brokers are looked at.
constexpr std::chrono::milliseconds look_pause{500};

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
  // The fence of a bolt that sends compares them with the time at which it was raised.
  runtime.births = std::any_of(options.definition.bolts.begin(), options.definition.bolts.end(),
                               [](const auto& bolt) { return bolt.endpoint.has_value(); });
  return runtime;
}

}  // namespace

struct Worker::Impl {
  explicit Impl(WorkerOptions given)
      : options(std::move(given)),
        services(make_endpoint_services(options.definition, options.clock, options.metrics)) {
    const TopologyDefinition& definition = options.definition;
    load_libraries(definition, options.library_folders, options.components, options.libraries);
    if (options.fence) services->fence = options.fence;
    services->longest_drain = options.longest_drain;
    watch.emplace(links_of(services->brokers), *services->clock, *services->metrics,
                  config::Labels{{"topology", services->topology.str()}});
    std::map<std::string, std::string> certificates;
    for (const auto& [name, broker] : definition.brokers) certificates[name] = broker.tls.certificate_file;
    certificate_days.emplace(security::certificates_for_brokers(certificates), *services->metrics);
    if (!definition.order_keys.empty()) trust_masters(definition);
    topology = assemble(definition, options.components, endpoint_factories(services));
    services->keepers = keepers_by_spout(topology);
    services->agreements = agreements_by_spout(definition, topology);
    if (options.registry == nullptr && definition.registry.url.empty()) {
      throw definition.root.error("", "the key \"zk.servers\" is missing",
                                  "add \"zk.servers: [\\\"host:2181\\\"]\", or \"registry: embedded://NAME\"");
    }
  }

  void trust_masters(const TopologyDefinition& definition) {
    security::TrustedKeys::Options trust;
    trust.require_signature = true;
    trust.trusted_keys = definition.order_keys;
    try {
      masters = std::make_shared<security::TrustedKeys>(trust);
    } catch (const config::Error& error) {
      throw definition.root.error("orders.trusted_keys", error.what(), "name the masters' public keys");
    }
  }

  void start(const std::stop_token& stop) {
    if (options.registry == nullptr) {
      own_registry = discovery::make_registry(options.definition.registry);
      options.registry = own_registry.get();
    }
    services->registry = options.registry;
    if (!options.fence && services->clock == &config::system_clock())
      heart.emplace(*services->fence, longest_standstill(*services));
    if (!name_is_free(stop)) return;
    if (const std::string crossed = crossings(options.definition, topology);
        !crossed.empty() && !stay_alone(crossed, stop))
      return;
    RuntimeOptions how = runtime_options(options);
    how.troubles = services->troubles.get();
    runtime = std::make_unique<Runtime>(topology, std::move(how));
    services->traces->on_change([this](bool any) { runtime->trace(any); });
    taps = std::make_unique<TapDesk>(*runtime, TapDesk::Options{.clock = options.clock});
    runtime->deactivate();  // WorkerControl activates it when it knows the orders
    runtime->start();
    running = true;
    control = std::make_unique<WorkerControl>(control_options());
    watching = std::jthread([this](const std::stop_token& end) { watch_brokers(end); });
    control->start();  // after everything that a kill order ends
    worker_logger.info("topology {} runs as worker {}", topology.name, services->worker);
  }

  /// What hinders brokers and components now; empty: nothing.
  std::string trouble() {
    std::string text = watch->trouble();
    const std::string board = services->troubles->line();
    if (!board.empty()) text += (text.empty() ? "" : "; ") + board;
    const std::string call = hanging();
    if (!call.empty()) text += (text.empty() ? "" : "; ") + call;
    return text;
  }

  /// The task whose code does not return, for people; empty: none. The text stays the same as long as the call lasts.
  std::string hanging() {
    if (!running) return "";
    const LongCall call = runtime->longest_call();
    const config::MutexLock lock(hanging_mutex);
    if (call.age < hanging_limit) {
      hanging_text.clear();
      return "";
    }
    const auto begun = services->clock->now() - call.age;
    const bool same = !hanging_text.empty() && call.task == hanging_task && begun - hanging_since < hanging_limit;
    if (same) return hanging_text;
    hanging_task = call.task;
    hanging_since = begun;
    hanging_text = fmt::format("{}: task {} hangs, a call of its code did not return for {} s before {:%FT%TZ}",
                               call.component, call.task, hanging_limit.count() / 1000,
                               fmt::gmtime(static_cast<std::time_t>(services->clock->wall_ms() / 1000)));
    return hanging_text;
  }

  /// Looks at brokers and components, and shows what is wrong in the worker's record, for `iotcloud status`.
  void watch_brokers(const std::stop_token& stop) {
    config::Mutex mutex;
    config::StoppableConditionVariable end;
    const config::MutexLock lock(mutex);
    while (!end.wait_for(mutex, stop, look_pause, [&] { return stop.stop_requested(); })) {
      std::string text = trouble();
      const std::string limits = services->held->limits();
      if (!limits.empty()) text += (text.empty() ? "" : "; ") + limits;
      control->show_trouble(text);
    }
  }

  /// \return whether a stop was asked for before the time was over
  static bool pause(std::chrono::milliseconds time, const std::stop_token& stop) {
    config::Mutex mutex;
    config::StoppableConditionVariable end;
    const config::MutexLock lock(mutex);
    return end.wait_for(mutex, stop, time, [&] { return stop.stop_requested(); });
  }

  /// Waits until the registry answers. \return false if it does not, or if a stop was asked for meanwhile
  bool registry_answers(const std::stop_token& stop) {
    const auto deadline = std::chrono::steady_clock::now() + registry_patience;
    while (options.registry->session() != discovery::SessionState::connected) {
      if (std::chrono::steady_clock::now() >= deadline || pause(std::chrono::milliseconds(10), stop)) return false;
    }
    return true;
  }

  /// Makes sure that Apache Storm runs no topology of this name. The nodes of its workers that were killed stay until
  /// their sessions expire, so this waits that long for them. When the registry does not tell, the worker runs, and the
  /// groups of readers see to it that only one of the two reads. \return false if a stop was asked for meanwhile.
  bool name_is_free(const std::stop_token& stop) {
    if (!registry_answers(stop)) {
      if (stop.stop_requested()) return false;
      worker_logger.warn("topology {}: the registry is away, so this worker cannot tell whether Storm runs one, too",
                         topology.name);
      return true;
    }
    const auto deadline =
        std::chrono::steady_clock::now() + options.definition.registry.session_timeout + std::chrono::seconds(2);
    for (bool told = false;;) {
      std::string taken;
      try {
        taken = discovery::taken_by_storm(*options.registry, services->paths, services->topology);
      } catch (const discovery::RegistryError& error) {
        worker_logger.warn("topology {}: whether Storm runs one, too, cannot be told: {}", topology.name, error.what());
      }
      if (taken.empty()) return true;
      if (std::chrono::steady_clock::now() >= deadline) throw options.definition.root.error("topology.name", taken);
      if (!std::exchange(told, true))
        worker_logger.warn(
            "{}; this worker waits for the end of that one for as long as the session of a dead one lasts", taken);
      if (pause(std::chrono::seconds(1), stop)) return false;  // each look reads the groups of the whole fleet
    }
  }

  /// Makes sure that this is the topology's only worker, by an ephemeral node that only one worker can hold. The node
  /// of a worker that was killed stays until its session expires, so this waits that long for it. \return false if a
  /// stop was asked for meanwhile.
  bool stay_alone(const std::string& crossed, const std::stop_token& stop) {
    const std::string path = services->paths.topology(services->topology) + "/alone";
    const auto patience = options.definition.registry.session_timeout + std::chrono::seconds(2);
    auto deadline = std::chrono::steady_clock::now() + patience;
    for (bool told = false;;) {
      try {
        alone = options.registry->hold(path, services->worker);
        return true;
      } catch (const discovery::RegistryError& error) {
        if (error.code() == discovery::RegistryErrorCode::away) {
          worker_logger.warn("topology {}: the registry is away, so this worker cannot tell whether another one runs",
                             topology.name);
          alone = options.registry->hold_eventually(path, services->worker);
          return true;
        }
        if (error.code() == discovery::RegistryErrorCode::denied) {
          if (!std::exchange(told, true))
            worker_logger.warn("topology {}: {}; this worker waits until a master has made the registry's branches",
                               topology.name, error.what());
          if (pause(std::chrono::milliseconds(100), stop)) return false;
          deadline = std::chrono::steady_clock::now() + patience;
          continue;
        }
        if (error.code() != discovery::RegistryErrorCode::exists) throw;
      }
      if (std::chrono::steady_clock::now() >= deadline) {
        throw options.definition.root.error(
            "topology.name",
            "another worker runs topology \"" + topology.name +
                "\", and these inputs reach across drivers, of which each worker would have only its share:\n" +
                crossed,
            "run it on Apache Storm, which carries tuples from worker to worker (docs/storm.md): iotcloud topology "
            "submit --engine storm; or run one worker; or use a key with driverID; or, if each worker should process "
            "its share only, give these bolts \"scope: worker\" (or write \"topology.scope: worker\")");
      }
      if (!std::exchange(told, true)) {
        worker_logger.warn(
            "topology {}: another worker holds the place of the only one; this one waits up to {} ms, in which the "
            "place "
            "of a dead worker would become free. If that one is alive, this one is refused: these inputs reach across "
            "drivers, of which each worker would have only its share; \"scope: worker\" at these bolts says that this "
            "is "
            "meant:\n{}",
            topology.name, patience.count(), crossed);
      }
      if (pause(std::chrono::milliseconds(100), stop)) return false;
    }
  }

  WorkerControl::Options control_options() {
    WorkerControl::Options control_options;
    control_options.services = services;
    control_options.runtime = runtime.get();
    control_options.topology.name = services->topology;
    control_options.topology.since_ms = services->clock->wall_ms();
    for (const auto& component : topology.components) {
      auto& kind = component.spout ? control_options.topology.spouts : control_options.topology.bolts;
      kind.push_back(component.id);
    }
    control_options.worker.name = services->worker;
    control_options.worker.host = config::host_name();
    control_options.worker.pid = getpid();
    control_options.worker.http = http_address;
    control_options.worker.tls = http_tls;
    control_options.worker.since_ms = control_options.topology.since_ms;
    control_options.masters = masters;
    control_options.on_joined = options.on_joined;
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

  /// Ends the topology and leaves the registry; once.
  void finish(std::chrono::milliseconds limit) {
    const config::MutexLock lock(finish_mutex);
    if (std::exchange(finished, true)) return;
    watching = {};
    for (const auto& prepare : services->before_stop) prepare();
    const auto drain = std::max(limit - reserve, limit / 2);
    if (!runtime->stop(drain)) {
      const std::string left = left_behind(topology, runtime->snapshot());
      worker_logger.warn("topology {}: the {} ms to finish what was under way are over; {}", topology.name,
                         drain.count(), left.empty() ? "no tuple is left" : left);
    }
    alone.reset();
    if (control) control->leave();
    for (const auto& clear_up : services->after_stop) clear_up();
    heart.reset();
  }

  WorkerOptions options;
  const EndpointServicesPtr services;
  std::shared_ptr<security::TrustedKeys> masters;  ///< whose orders are followed; null: orders need no signature
  Topology topology;
  std::optional<BrokerWatch> watch;
  std::optional<security::CertificateDays> certificate_days;  ///< of those that brokers are shown
  std::unique_ptr<discovery::Registry> own_registry;
  discovery::GuardPtr alone;  ///< the place of the only worker, for a topology that allows only one
  std::string http_address;   ///< constant after start(), as http_tls
  bool http_tls = false;
  std::unique_ptr<Runtime> runtime;
  std::unique_ptr<TapDesk> taps;
  std::atomic<bool> running{false};  ///< runtime and taps exist
  config::Mutex hanging_mutex;
  int hanging_task IOTCLOUD_GUARDED_BY(hanging_mutex) = 0;
  config::Clock::Instant hanging_since IOTCLOUD_GUARDED_BY(hanging_mutex){};
  std::string hanging_text IOTCLOUD_GUARDED_BY(hanging_mutex);
  config::Mutex finish_mutex;
  bool finished IOTCLOUD_GUARDED_BY(finish_mutex) = false;
  std::unique_ptr<WorkerControl> control;  ///< destroyed before the runtime, which it uses
  std::jthread watching;                   ///< watch_brokers(); ends before the control, which it uses
  std::optional<FenceHeart> heart;         ///< tells the fence that this process runs
};

Worker::Worker(WorkerOptions options) : impl_(std::make_unique<Impl>(std::move(options))) {}

Worker::~Worker() {
  try {
    stop(std::chrono::seconds(5));
  } catch (const std::exception& error) {
    worker_logger.error("the worker failed while it stopped: {}", error.what());
  }
}

void Worker::start(const std::stop_token& stop) {
  impl_->start(stop);
}

void Worker::stop(std::chrono::milliseconds limit) {
  impl_->stop(limit);
}

std::string Worker::trouble() const {
  std::string text = impl_->trouble();
  if (impl_->options.registry->session() != discovery::SessionState::connected)
    text = "the registry is away" + (text.empty() ? "" : "; " + text);
  return text;
}

void Worker::reload() {
  if (impl_->masters) impl_->masters->reload();
}

void Worker::show_http_address(std::string address, bool tls) {
  impl_->http_address = std::move(address);
  impl_->http_tls = tls;
}

const std::string& Worker::name() const {
  return impl_->services->worker;
}

std::string Worker::describe() const {
  if (!impl_->running) throw config::Error("the worker is starting; ask again in a moment");
  return topology::describe(*impl_->runtime, impl_->services->worker, impl_->watch->look(), impl_->services->arrivals);
}

TapDesk& Worker::taps() {
  if (!impl_->running) throw config::Error("the worker is starting; ask again in a moment");
  return *impl_->taps;
}

MessageTraces& Worker::traces() {
  if (!impl_->running) throw config::Error("the worker is starting; ask again in a moment");
  return *impl_->services->traces;
}

const std::map<std::string, std::shared_ptr<const Arrivals>>& Worker::arrivals() const {
  if (!impl_->running) throw config::Error("the worker is starting; ask again in a moment");
  return impl_->services->arrivals;
}

const std::string& Worker::topology() const {
  return impl_->topology.name;
}

const config::Clock& Worker::clock() const {
  return *impl_->services->clock;
}

LongCall Worker::longest_call() const {
  return impl_->running ? impl_->runtime->longest_call() : LongCall{};
}

Snapshot Worker::snapshot() const {
  return impl_->runtime ? impl_->runtime->snapshot() : Snapshot{};
}

}  // namespace iotcloud::topology
