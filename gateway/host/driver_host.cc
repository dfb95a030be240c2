#include <algorithm>
#include <future>
#include <map>
#include <utility>
#include <vector>

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/gateway/host/broker_states.h>
#include <iotcloud/gateway/host/driver_host.h>
#include <iotcloud/gateway/host/driver_instance.h>
#include <iotcloud/gateway/host/event_loop.h>
#include <iotcloud/gateway/host/lease.h>
#include <iotcloud/gateway/host/logger.h>
#include <iotcloud/gateway/host/losses.h>
#include <iotcloud/gateway/host/round_trips.h>

namespace iotcloud::gateway {

namespace {

/// The instance's lease; nullopt also for an invalid one, which a gateway refuses before it gets here.
std::optional<std::chrono::milliseconds> valid_lease(const InstanceSpec& spec) {
  try {
    return lease_of(spec.order.properties);
  } catch (const config::Error&) {
    return std::nullopt;
  }
}

bool wants_own_thread(const Plugin& plugin, const InstanceSpec& spec) {
  const auto property = spec.order.properties.find("thread");
  return plugin.descriptor().own_thread || (property != spec.order.properties.end() && property->second == "own");
}

}  // namespace

struct DriverHost::Impl : std::enable_shared_from_this<DriverHost::Impl> {
  Impl(const Options& options, std::shared_ptr<const Plugin> plugin, Listener host_listener)
      : listener(std::move(host_listener)),
        environment(std::make_shared<HostEnvironment>()),
        losses(options.clock != nullptr ? *options.clock : config::system_clock()) {
    environment->gateway = options.gateway;
    environment->isolated = options.isolated;
    environment->drain_limit = options.drain_limit;
    environment->state_folder = options.state_folder;
    environment->plugin = std::move(plugin);
    environment->report_found = options.on_found ? options.on_found : [](const FoundReport&) {};
    environment->clock = options.clock != nullptr ? options.clock : &config::system_clock();
    environment->metrics = options.metrics != nullptr ? options.metrics : &config::process_metrics();
    environment->brokers = std::make_unique<brokers::BrokerPool>(nullptr, environment->metrics);
    environment->closing = std::make_shared<EventLoop>("close");
    environment->shared_channels = std::make_unique<SharedChannels>(environment->closing, *environment->clock,
                                                                    *environment->metrics, options.passing);
    shared_loop = std::make_shared<EventLoop>(environment->plugin->name());
    own_samples = environment->metrics->add_source([this](auto& samples) {
      show_brokers(samples);
      show_backlogs(samples);
      append_round_trips(environment->round_trips, environment->plugin->name(), samples);
    });
  }

  /// Appends for each broker that an instance uses whether it is away.
  void show_brokers(std::vector<config::Sample>& samples) const {
    for (const auto& [address, broker] : environment->brokers->in_use()) {
      config::Sample sample;
      sample.name = broker_away_metric;
      sample.help = "1: a broker that drivers use cannot be reached, or takes no messages";
      sample.labels = {{"plugin", environment->plugin->name()},
                       {"broker", address.broker},
                       {"url", brokers::printable_url(broker->url())}};
      sample.kind = config::Sample::Kind::gauge;
      sample.value = broker->state() == brokers::ConnectionState::connected ? 0 : 1;
      samples.push_back(std::move(sample));
    }
  }

  std::vector<std::shared_ptr<DriverInstance>> all() const {
    std::vector<std::shared_ptr<DriverInstance>> all;
    const config::MutexLock lock(mutex);
    for (const auto& [id, instance] : instances) all.push_back(instance);
    return all;
  }

  /// Appends for each channel what waits in it, of all instances together.
  void show_backlogs(std::vector<config::Sample>& samples) const {
    std::map<std::pair<std::string, std::string>, ChannelQueue::Backlog> backlogs;  // by driver and channel
    for (const auto& instance : all()) {
      instance->each_backlog([&](const discovery::ChannelRecord& channel, const ChannelQueue::Backlog& backlog) {
        auto& sum = backlogs[{channel.driver, channel.name}];
        sum.waiting += backlog.waiting;
        sum.oldest = std::max(sum.oldest, backlog.oldest);
      });
    }
    const auto add = [&](const char* name, const char* help, const auto& key, double value) {
      config::Sample sample;
      sample.name = name;
      sample.help = help;
      sample.labels = {{"driver", key.first}, {"channel", key.second}};
      sample.kind = config::Sample::Kind::gauge;
      sample.value = value;
      samples.push_back(std::move(sample));
    };
    for (const auto& [key, backlog] : backlogs) {
      add("iotcloud_driver_channel_waiting",
          "Messages of a channel that the broker has not confirmed, or that the driver has not taken", key,
          static_cast<double>(backlog.waiting));
      add("iotcloud_driver_channel_oldest_seconds", "Age of the oldest of these messages", key,
          std::chrono::duration<double>(backlog.oldest).count());
    }
  }

  std::shared_ptr<DriverInstance> find(const discovery::InstanceId& id) IOTCLOUD_REQUIRES(mutex) {
    const auto found = instances.find(id);
    return found == instances.end() ? nullptr : found->second;
  }

  void reported(const InstanceStatus& status) {
    if (status.state == discovery::DriverState::undeployed) {
      environment->shared_channels->expect_no_more(status.instance);
    } else if (status.state == discovery::DriverState::failed) {
      environment->shared_channels->failed(status.instance);
    }
    std::shared_ptr<DriverInstance> gone;  // destroyed without the lock, because its own event loop may end with it
    {
      const config::MutexLock lock(mutex);
      if (status.state == discovery::DriverState::undeployed) {
        const auto found = instances.find(status.instance);
        if (found != instances.end()) {
          gone = std::move(found->second);
          instances.erase(found);
        }
        suspended.erase(status.instance);
      } else if (status.state == discovery::DriverState::failed) {
        suspended.erase(status.instance);
      }
    }
    listener(status);
    changed.notify_all();
  }

  void leave_behind() IOTCLOUD_REQUIRES(mutex);
  std::string what_is_left(std::chrono::milliseconds limit) const IOTCLOUD_REQUIRES(mutex);
  std::shared_ptr<EventLoop> loop_for(const InstanceSpec& spec) const;
  bool lease_runs(const InstanceSpec& spec) const IOTCLOUD_REQUIRES(mutex);
  void suspend(const std::shared_ptr<DriverInstance>& instance, const std::string& reason);
  void start_suspended();

  const Listener listener;
  std::shared_ptr<HostEnvironment> environment;
  std::shared_ptr<EventLoop> shared_loop;
  mutable config::Mutex mutex;
  config::ConditionVariable changed;
  std::map<discovery::InstanceId, std::shared_ptr<DriverInstance>> instances IOTCLOUD_GUARDED_BY(mutex);
  /// The instances that have no lease, and whether each has closed: only then may its successor open its channels.
  std::map<discovery::InstanceId, bool> suspended IOTCLOUD_GUARDED_BY(mutex);
  LeaseConfirmation confirmation IOTCLOUD_GUARDED_BY(mutex);
  std::int64_t confirmed_ms IOTCLOUD_GUARDED_BY(mutex) = 0;  ///< wall time at which the latest confirmation came
  bool stopped IOTCLOUD_GUARDED_BY(mutex) = false;
  std::string left IOTCLOUD_GUARDED_BY(mutex);                      ///< why stop() returned false
  std::vector<BrokerLink> seen_brokers IOTCLOUD_GUARDED_BY(mutex);  ///< see brokers()
  config::Mutex losses_mutex;
  Losses losses IOTCLOUD_GUARDED_BY(losses_mutex);
  config::Metrics::SourceRegistration own_samples;  ///< ends first, because it uses the other members
};

/// Leaks the instances and what they share, because a stuck thread may use them until the process ends.
void DriverHost::Impl::leave_behind() {
  auto kept = std::make_unique<std::vector<std::shared_ptr<void>>>();
  kept->push_back(environment);
  for (const auto& [id, instance] : instances) {
    instance->loop()->abandon();
    kept->push_back(instance);
  }
  static_cast<void>(kept.release());
}

/// Why instances have not ended within the limit: a driver does not return, or what was published is still being sent.
std::string DriverHost::Impl::what_is_left(std::chrono::milliseconds limit) const {
  std::string in_callback;
  std::size_t sending = 0;
  for (const auto& [id, instance] : instances) {
    if (instance->driver_gone()) {
      ++sending;
    } else if (instance->loop()->serving() == instance->number()) {
      in_callback += (in_callback.empty() ? "" : ", ") + id.str();
    }
  }
  std::string text = fmt::format("{} instance(s) did not end within {} ms", instances.size(), limit.count());
  if (!in_callback.empty())
    text += fmt::format("; a driver is stuck in a callback, and its thread is left behind: {}", in_callback);
  if (sending > 0) text += fmt::format("; {} of them have closed, and were sending what they had published", sending);
  return text;
}

DriverHost::DriverHost(const Options& options, std::shared_ptr<const Plugin> plugin, Listener listener)
    : impl_(std::make_shared<Impl>(options, std::move(plugin), std::move(listener))) {
  impl_->environment->report = [weak = std::weak_ptr<Impl>(impl_)](const InstanceStatus& status) {
    if (const auto impl = weak.lock()) impl->reported(status);
  };
}

DriverHost::~DriverHost() {
  stop(std::chrono::seconds{5});
}

void DriverHost::create(const InstanceSpec& spec) {
  std::shared_ptr<DriverInstance> instance;
  std::shared_ptr<DriverInstance>
      failed;  // destroyed without the lock: it may end its event loop, whose thread may lock it
  bool runs = true;
  {
    const config::MutexLock lock(impl_->mutex);
    if (impl_->stopped) return;
    auto& slot = impl_->instances[spec.order.instance];
    if (slot && slot->status().state != discovery::DriverState::failed) {
      host_logger.warn("instance {} runs already; the order to create it is ignored", spec.order.instance);
      return;
    }
    instance = std::make_shared<DriverInstance>(impl_->environment, spec, impl_->loop_for(spec));
    failed = std::exchange(slot, instance);
    runs = impl_->lease_runs(spec);
    if (!runs) impl_->suspended[spec.order.instance] = false;
  }
  if (!runs) {
    impl_->suspend(instance, "not started: its gateway has no lease");
    return;
  }
  impl_->environment->shared_channels->expect(spec.order.instance);
  instance->open();
}

std::shared_ptr<EventLoop> DriverHost::Impl::loop_for(const InstanceSpec& spec) const {
  const Plugin& plugin = *environment->plugin;
  return wants_own_thread(plugin, spec) ? std::make_shared<EventLoop>(plugin.name()) : shared_loop;
}

bool DriverHost::Impl::lease_runs(const InstanceSpec& spec) const {
  const auto lease = valid_lease(spec);
  return !lease || confirmation.left(*lease, environment->clock->now()).count() > 0;
}

/// Closes an instance that is in `suspended`, which start_suspended() may create anew afterwards.
void DriverHost::Impl::suspend(const std::shared_ptr<DriverInstance>& instance, const std::string& reason) {
  instance->suspend(reason, [weak = weak_from_this(), id = instance->spec().order.instance] {
    const auto self = weak.lock();
    if (!self) return;
    {
      const config::MutexLock lock(self->mutex);
      const auto found = self->suspended.find(id);
      if (found == self->suspended.end()) return;  // it was removed meanwhile
      found->second = true;
    }
    self->start_suspended();
  });
}

/// Creates anew the instances that have closed and whose lease runs again.
void DriverHost::Impl::start_suspended() {
  std::vector<std::shared_ptr<DriverInstance>> fresh, former;  // the former ones are destroyed without the lock
  {
    const config::MutexLock lock(mutex);
    if (stopped) return;
    for (auto entry = suspended.begin(); entry != suspended.end();) {
      auto& slot = instances.at(entry->first);
      const auto spec = slot->spec();
      if (!entry->second || !lease_runs(spec)) {
        ++entry;
        continue;
      }
      fresh.push_back(std::make_shared<DriverInstance>(environment, spec, loop_for(spec)));
      former.push_back(std::exchange(slot, fresh.back()));
      entry = suspended.erase(entry);
    }
  }
  for (const auto& instance : fresh) {
    environment->shared_channels->expect(instance->spec().order.instance);
    instance->open();
  }
}

void DriverHost::renew(config::Clock::Instant confirmed) {
  {
    const config::MutexLock lock(impl_->mutex);
    if (impl_->confirmation.renew(confirmed)) impl_->confirmed_ms = impl_->environment->clock->wall_ms();
  }
  impl_->start_suspended();
}

std::optional<std::chrono::milliseconds> DriverHost::enforce_leases() {
  std::optional<std::chrono::milliseconds> next;
  const auto now = impl_->environment->clock->now();
  const config::MutexLock lock(impl_->mutex);
  for (const auto& [id, instance] : impl_->instances) {
    const auto lease = valid_lease(instance->spec());
    if (!lease || impl_->suspended.contains(id) || instance->status().state == discovery::DriverState::failed) continue;
    const auto left = impl_->confirmation.left(*lease, now);
    if (left.count() > 0) {
      const auto rounded = std::chrono::ceil<std::chrono::milliseconds>(left);
      next = next ? std::min(*next, rounded) : rounded;
      continue;
    }
    impl_->suspended[id] = false;
    impl_->environment->metrics
        ->counter("iotcloud_driver_lease_stops_total", "Instances stopped because their lease ran out",
                  {{"plugin", impl_->environment->plugin->name()}})
        .add();
    impl_->suspend(instance, fmt::format("stopped: no lease since {:%FT%TZ}", fmt::gmtime(impl_->confirmed_ms / 1000)));
  }
  return next;
}

// These commands hold the mutex, so that start_suspended() does not replace the instance meanwhile.

void DriverHost::tell_found() {
  const config::MutexLock lock(impl_->mutex);
  for (const auto& [id, instance] : impl_->instances) instance->tell_found();
}

void DriverHost::activate(const discovery::InstanceId& instance) {
  const config::MutexLock lock(impl_->mutex);
  if (const auto found = impl_->find(instance)) found->activate();
}

void DriverHost::deactivate(const discovery::InstanceId& instance) {
  const config::MutexLock lock(impl_->mutex);
  if (const auto found = impl_->find(instance)) found->deactivate();
}

void DriverHost::remove(const discovery::InstanceId& instance, Removal removal) {
  {
    const config::MutexLock lock(impl_->mutex);
    impl_->suspended.erase(instance);
    if (const auto found = impl_->find(instance)) {
      found->remove(removal);
      return;
    }
  }
  InstanceStatus status;
  status.instance = instance;
  status.state = discovery::DriverState::undeployed;
  status.since_ms = impl_->environment->clock->wall_ms();
  impl_->listener(status);
}

bool DriverHost::stop(std::chrono::milliseconds limit) {
  config::UniqueLock lock(impl_->mutex);
  if (impl_->stopped) return true;
  impl_->stopped = true;
  for (const auto& [id, instance] : impl_->instances) instance->remove(Removal::replaced);
  const bool done = impl_->changed.wait_for(impl_->mutex, limit, [&impl = *impl_] {
    impl.mutex.assert_held();
    return impl.instances.empty();
  });
  if (!done) {
    impl_->left = impl_->what_is_left(limit);
    host_logger.error("{}: {}", impl_->environment->plugin->name(), impl_->left);
    impl_->leave_behind();
    return false;
  }
  lock.unlock();
  // This runs after the last report and after the drains of failed instances.
  auto over = std::make_shared<std::promise<void>>();
  impl_->environment->closing->post([over] { over->set_value(); });
  if (over->get_future().wait_for(limit) == std::future_status::ready) return true;
  lock.lock();
  impl_->left = fmt::format("messages of failed instances were not sent within {} ms", limit.count());
  return false;
}

std::string DriverHost::left_behind() const {
  const config::MutexLock lock(impl_->mutex);
  return impl_->left;
}

void DriverHost::deliver(PassedMessage passed) {
  impl_->environment->shared_channels->take(std::move(passed));
}

void DriverHost::answered(std::int64_t number, PassAnswer answer) {
  impl_->environment->shared_channels->answered(number, answer);
}

void DriverHost::nobody_answers() {
  impl_->environment->shared_channels->nobody_answers();
}

void DriverHost::ask(ChannelQuestion question, const std::function<void(discovery::ChannelLook)>& done) {
  std::shared_ptr<DriverInstance> instance;
  {
    const config::MutexLock lock(impl_->mutex);
    instance = impl_->find(question.look.instance);
  }
  if (instance) {
    instance->ask(std::move(question), done);
    return;
  }
  discovery::ChannelLook answer;
  answer.problem = fmt::format("instance {} does not run in its driver host now", question.look.instance);
  done(std::move(answer));
}

std::vector<BrokerLink> DriverHost::brokers() {
  const std::int64_t now = impl_->environment->clock->wall_ms();
  std::vector<BrokerLink> links;
  for (const auto& [address, broker] : impl_->environment->brokers->in_use()) {
    links.push_back({address.broker, brokers::printable_url(broker->url()), brokers::to_string(broker->state()), now,
                     broker->problem()});
  }
  const config::MutexLock lock(impl_->mutex);
  for (auto& link : links) {
    const auto before = std::find_if(impl_->seen_brokers.begin(), impl_->seen_brokers.end(), [&](const auto& seen) {
      return seen.broker == link.broker && seen.url == link.url;
    });
    if (before != impl_->seen_brokers.end() && before->state == link.state) link.since_ms = before->since_ms;
  }
  impl_->seen_brokers = links;
  return links;
}

std::vector<LosingChannel> DriverHost::losing() {
  const auto open = impl_->all();
  const config::MutexLock lock(impl_->losses_mutex);
  impl_->losses.begin();
  for (const auto& instance : open) {
    instance->each_tally([&](const discovery::ChannelRecord& channel, const ChannelTally& tally) {
      impl_->losses_mutex.assert_held();
      impl_->losses.see(channel.instance, channel.name, tally.losses());
    });
  }
  return impl_->losses.end();
}

std::vector<HostedInstance> DriverHost::list() const {
  const config::MutexLock lock(impl_->mutex);
  std::vector<HostedInstance> all;
  for (const auto& [id, instance] : impl_->instances) all.push_back({instance->spec(), instance->status()});
  return all;
}

const Plugin& DriverHost::plugin() const {
  return *impl_->environment->plugin;
}

std::vector<Stall> DriverHost::stalls() {
  const config::MutexLock lock(impl_->mutex);
  std::vector<Stall> stalls;
  Stall shared{{}, false, impl_->shared_loop->stalled(), {}};
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
