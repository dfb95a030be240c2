#include <condition_variable>
#include <future>
#include <map>
#include <mutex>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/gateway/host/driver_host.h>
#include <iotcloud/gateway/host/event_loop.h>
#include <iotcloud/gateway/host/instance/instance.h>

namespace iotcloud::gateway {

namespace {

constexpr config::Logger log{"gateway.host"};

bool wants_own_thread(const Plugin& plugin, const InstanceSpec& spec) {
  const auto property = spec.order.properties.find("thread");
  return plugin.descriptor().own_thread || (property != spec.order.properties.end() && property->second == "own");
}

}  // namespace

struct DriverHost::Impl {
  Impl(const Options& options, std::shared_ptr<const Plugin> plugin, Listener host_listener)
      : listener(std::move(host_listener)), environment(std::make_shared<HostEnvironment>()) {
    environment->gateway = options.gateway;
    environment->isolated = options.isolated;
    environment->drain_limit = options.drain_limit;
    environment->state_folder = options.state_folder;
    environment->plugin = std::move(plugin);
    environment->clock = options.clock != nullptr ? options.clock : &config::system_clock();
    environment->metrics = options.metrics != nullptr ? options.metrics : &config::process_metrics();
    environment->brokers = std::make_unique<brokers::BrokerPool>(nullptr, environment->metrics);
    environment->shared_inboxes = std::make_unique<SharedInboxes>(*environment->clock, *environment->metrics);
    environment->closing = std::make_shared<EventLoop>("close");
    shared_loop = std::make_shared<EventLoop>(environment->plugin->name());
  }

  std::shared_ptr<Instance> find(const std::string& id) {
    const std::lock_guard lock(mutex);
    const auto found = instances.find(id);
    return found == instances.end() ? nullptr : found->second;
  }

  void reported(const InstanceStatus& status) {
    std::shared_ptr<Instance> gone;  // its own loop may die with it: outside the lock
    {
      const std::lock_guard lock(mutex);
      if (status.state == discovery::DriverState::undeployed) {
        const auto found = instances.find(status.instance);
        if (found != instances.end()) {
          gone = std::move(found->second);
          instances.erase(found);
        }
      }
    }
    listener(status);
    changed.notify_all();
  }

  const Listener listener;
  std::shared_ptr<HostEnvironment> environment;
  std::shared_ptr<EventLoop> shared_loop;
  mutable std::mutex mutex;
  std::condition_variable changed;
  std::map<std::string, std::shared_ptr<Instance>> instances;  ///< guarded by mutex
  bool stopped = false;                                        ///< guarded by mutex
};

namespace {

/// A stuck thread may still use its instance and all that instances share: that stays until the process ends.
template <typename Host>
void leave_behind(Host& host) {
  auto kept = std::make_unique<std::vector<std::shared_ptr<void>>>();
  kept->push_back(host.environment);
  for (const auto& [id, instance] : host.instances) {
    instance->loop()->abandon();
    kept->push_back(instance);
  }
  static_cast<void>(kept.release());
}

}  // namespace

DriverHost::DriverHost(Options options, std::shared_ptr<const Plugin> plugin, Listener listener)
    : impl_(std::make_shared<Impl>(options, std::move(plugin), std::move(listener))) {
  impl_->environment->report = [weak = std::weak_ptr<Impl>(impl_)](const InstanceStatus& status) {
    if (const auto impl = weak.lock()) impl->reported(status);
  };
}

DriverHost::~DriverHost() {
  stop(std::chrono::seconds{5});
}

void DriverHost::create(const InstanceSpec& spec) {
  std::shared_ptr<Instance> instance;
  {
    const std::lock_guard lock(impl_->mutex);
    if (impl_->stopped) return;
    auto& slot = impl_->instances[spec.order.instance];
    if (slot && slot->status().state != discovery::DriverState::failed) {
      log.warn("instance {} runs already; the order to create it is ignored", spec.order.instance);
      return;
    }
    const auto& plugin = *impl_->environment->plugin;
    auto loop = wants_own_thread(plugin, spec) ? std::make_shared<EventLoop>(plugin.name()) : impl_->shared_loop;
    instance = std::make_shared<Instance>(impl_->environment, spec, std::move(loop));
    slot = instance;
  }
  instance->open();
}

void DriverHost::activate(const std::string& instance) {
  if (const auto found = impl_->find(instance)) found->activate();
}

void DriverHost::deactivate(const std::string& instance) {
  if (const auto found = impl_->find(instance)) found->deactivate();
}

void DriverHost::remove(const std::string& instance) {
  if (const auto found = impl_->find(instance)) {
    found->remove();
    return;
  }
  InstanceStatus status;
  status.instance = instance;
  status.state = discovery::DriverState::undeployed;
  status.since_ms = impl_->environment->clock->wall_ms();
  impl_->listener(status);
}

bool DriverHost::stop(std::chrono::milliseconds limit) {
  std::unique_lock lock(impl_->mutex);
  if (impl_->stopped) return true;
  impl_->stopped = true;
  for (const auto& [id, instance] : impl_->instances) instance->remove();
  const bool done = impl_->changed.wait_for(lock, limit, [&] { return impl_->instances.empty(); });
  if (!done) {
    log.error("{}: {} instance(s) did not close within {} ms; a driver is stuck in a callback",
              impl_->environment->plugin->name(), impl_->instances.size(), limit.count());
    leave_behind(*impl_);
    return false;
  }
  lock.unlock();
  // The last report, and the drains of instances that had failed, are over when this has run.
  auto over = std::make_shared<std::promise<void>>();
  impl_->environment->closing->post([over] { over->set_value(); });
  return over->get_future().wait_for(limit) == std::future_status::ready;
}

std::vector<HostedInstance> DriverHost::list() const {
  const std::lock_guard lock(impl_->mutex);
  std::vector<HostedInstance> all;
  for (const auto& [id, instance] : impl_->instances) all.push_back({instance->spec(), instance->status()});
  return all;
}

const Plugin& DriverHost::plugin() const {
  return *impl_->environment->plugin;
}

std::vector<Stall> DriverHost::stalls() {
  const std::lock_guard lock(impl_->mutex);
  std::vector<Stall> stalls;
  Stall shared{"", false, impl_->shared_loop->stalled(), {}};
  const std::uint64_t served = impl_->shared_loop->serving();
  for (const auto& [id, instance] : impl_->instances) {
    if (instance->loop() == impl_->shared_loop) {
      if (instance->number() != served) continue;
      shared.instance = id;
      shared.limit = instance->hang_limit();
    } else if (const auto time = instance->loop()->stalled(); time.count() > 0) {
      stalls.push_back({id, true, time, instance->hang_limit()});
    }
  }
  if (shared.time.count() > 0) stalls.push_back(std::move(shared));
  return stalls;
}

}  // namespace iotcloud::gateway
