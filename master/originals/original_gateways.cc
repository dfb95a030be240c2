#include <map>
#include <set>
#include <stop_token>
#include <thread>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/log.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/gateways/site_client.h>
#include <iotcloud/master/orders/node_name.h>
#include <iotcloud/master/originals/original_gateways.h>

namespace iotcloud::master {

using discovery::DriverRecord;
using discovery::DriverState;
using discovery::GatewayId;
using discovery::GatewayRecord;
using discovery::InstanceId;
using std::chrono::milliseconds;

namespace {

constexpr config::Logger originals_logger{"master.original"};

}  // namespace

struct OriginalGateways::Impl {
  /// A gateway that this master looks after.
  struct Tended {
    explicit Tended(GatewayRecord r) : record(std::move(r)), site{record.host, record.port, {}, ""} {}
    const GatewayRecord record;
    const SiteAddress site;
    config::Mutex deploying;  ///< one deployment at a time, so that a new instance must be the result of it
    config::Mutex mutex;
    config::ConditionVariable registered;
    std::set<InstanceId> instances
        IOTCLOUD_GUARDED_BY(mutex);  ///< the gateway's registrations since this master looks after it
    discovery::GuardPtr alive IOTCLOUD_GUARDED_BY(mutex);  ///< null: lost
    std::jthread heart;                                    ///< last, because its thread uses the other members
  };
  using TendedPtr = std::shared_ptr<Tended>;

  Impl(discovery::Registry& r, OriginalGatewaysOptions o) : registry(r), options(std::move(o)) {}

  std::string marker(const GatewayId& gateway) const { return options.paths.gateway(gateway) + "/original"; }
  TendedPtr find(const GatewayId& gateway) const;
  void tend(const GatewayRecord& record, bool alive_now);
  void drop(const GatewayId& gateway);
  void drop_all();
  void follow_leadership(const std::stop_token& stop);
  void pick_up();
  void beat(const std::stop_token& stop, Tended& tended);
  void hold_alive_node(Tended& tended);
  static void remove_alive_node(Tended& tended);
  bool pause(const std::stop_token& stop) const;
  void write_driver(const DriverRecord& record);
  bool remove_record(const GatewayId& gateway, const InstanceId& instance);
  std::string registry_problem(const std::exception& e) const { return fmt::format("the registry: {}", e.what()); }

  discovery::Registry& registry;
  const OriginalGatewaysOptions options;
  std::function<bool()> leading;
  /// Held during a whole change of `tended`, also while the registry is called, so that one is made at a time.
  config::Mutex registering IOTCLOUD_ACQUIRED_BEFORE(mutex);
  mutable config::Mutex mutex;
  mutable config::StoppableConditionVariable pausing;  ///< only the end wakes it
  std::map<GatewayId, TendedPtr> tended IOTCLOUD_GUARDED_BY(mutex);
  bool leads IOTCLOUD_GUARDED_BY(mutex) = false;
  std::jthread leadership;
};

OriginalGateways::OriginalGateways(discovery::Registry& registry, OriginalGatewaysOptions options)
    : impl_(std::make_unique<Impl>(registry, std::move(options))) {}

OriginalGateways::~OriginalGateways() {
  stop();
}

void OriginalGateways::start(std::function<bool()> leading) {
  impl_->leading = std::move(leading);
  impl_->leadership =
      std::jthread([impl = impl_.get()](const std::stop_token& stop) { impl->follow_leadership(stop); });
}

void OriginalGateways::stop() {
  impl_->leadership = {};
  impl_->drop_all();
}

// ---------------------------------------------------------------- which gateways this master looks after

/// Waits for the heartbeat interval. \return false when the thread is to end.
bool OriginalGateways::Impl::pause(const std::stop_token& stop) const {
  const config::MutexLock lock(mutex);
  pausing.wait_for(mutex, stop, options.heartbeat_interval, [] { return false; });
  return !stop.stop_requested();
}

void OriginalGateways::Impl::follow_leadership(const std::stop_token& stop) {
  do {
    const bool now = leading();
    const bool before = [&] {
      const config::MutexLock lock(mutex);
      return leads;
    }();
    if (now && before) continue;
    try {
      if (now) {
        pick_up();
      } else {
        drop_all();
      }
      const config::MutexLock lock(mutex);
      leads = now;
    } catch (const config::Error& e) {
      originals_logger.warn("gateways of the original system cannot be looked after yet: {}", e.what());
    }
  } while (pause(stop));
}

/// Takes over the gateways that registered with an earlier master.
void OriginalGateways::Impl::pick_up() {
  const config::MutexLock one_at_a_time(registering);
  for (const auto& gateway : discovery::list_gateways(registry, options.paths)) {
    if (registry.get(marker(gateway.record.id)) && !find(gateway.record.id)) tend(gateway.record, false);
  }
}

OriginalGateways::Impl::TendedPtr OriginalGateways::Impl::find(const GatewayId& gateway) const {
  const config::MutexLock lock(mutex);
  const auto at = tended.find(gateway);
  return at == tended.end() ? nullptr : at->second;
}

void OriginalGateways::Impl::tend(const GatewayRecord& record, bool alive_now) {
  auto one = std::make_shared<Tended>(record);
  if (alive_now) hold_alive_node(*one);
  one->heart = std::jthread([this, &one = *one](const std::stop_token& stop) { beat(stop, one); });
  const config::MutexLock lock(mutex);
  tended[record.id] = std::move(one);
}

void OriginalGateways::Impl::drop(const GatewayId& gateway) {
  TendedPtr going;
  {
    const config::MutexLock lock(mutex);
    const auto at = tended.find(gateway);
    if (at == tended.end()) return;
    going = std::move(at->second);
    tended.erase(at);
  }
  going->heart = {};  // joins the thread without the lock, which the thread may take
  remove_alive_node(*going);
}

void OriginalGateways::Impl::remove_alive_node(Tended& one) {
  discovery::GuardPtr going;  // destroyed without the lock, because its destructor calls the registry
  const config::MutexLock lock(one.mutex);
  going.swap(one.alive);
}

void OriginalGateways::Impl::drop_all() {
  std::map<GatewayId, TendedPtr> going;
  {
    const config::MutexLock lock(mutex);
    going.swap(tended);
  }
  for (auto& [id, one] : going) one->heart.request_stop();
  for (auto& [id, one] : going) {
    one->heart = {};
    remove_alive_node(*one);
  }
}

void OriginalGateways::Impl::hold_alive_node(Tended& one) {
  auto alive = registry.hold(options.paths.gateway_alive(one.record.id), "");
  const config::MutexLock lock(one.mutex);
  one.alive = std::move(alive);
}

void OriginalGateways::Impl::beat(const std::stop_token& stop, Tended& one) {
  int misses = 0;
  while (pause(stop)) {
    const auto answer = site_heartbeat(one.site, options.heartbeat_limit);
    try {
      const bool alive = [&] {
        const config::MutexLock lock(one.mutex);
        return one.alive != nullptr;
      }();
      if (answer.outcome == OrderOutcome::done) {
        misses = 0;
        if (alive) continue;
        if (!registry.get(marker(one.record.id))) continue;  // it was forgotten: it has to register again
        hold_alive_node(one);
        originals_logger.info("gateway {} answers", one.record.id);
      } else if (++misses >= options.misses_until_lost && alive) {
        originals_logger.warn("gateway {} is lost: {}", one.record.id, answer.text);
        remove_alive_node(one);
      }
    } catch (const config::Error& e) {
      originals_logger.warn("gateway {}: its `alive` node cannot be changed in the registry: {}", one.record.id,
                            e.what());
    }
  }
}

// ---------------------------------------------------------------- calls from gateways

std::string OriginalGateways::register_gateway(GatewayRecord record) {
  if (!is_node_name(record.id))
    return fmt::format("\"{}\" cannot be a gateway's id: not empty, no '/', no control characters", record.id);
  if (record.host.empty() || record.port < 1 || record.port > 65535)
    return fmt::format("{}:{} is no address: heartbeats and orders go there", record.host, record.port);
  if (impl_->options.access && impl_->options.access->is_gateway(record.id))
    return fmt::format("{} is a gateway of this system, as registry.users says; give this one another id", record.id);
  const config::MutexLock one_at_a_time(impl_->registering);
  try {
    const auto node = impl_->registry.get(impl_->options.paths.gateway(record.id));
    if (node && !impl_->registry.get(impl_->marker(record.id)))
      return fmt::format("{} is a gateway of this system, also while it is away; give this one another id", record.id);
    if (node && impl_->registry.get(impl_->options.paths.gateway_alive(record.id))) {
      const auto there = discovery::decode_gateway(node->data, impl_->options.paths.gateway(record.id));
      if (!has(record.id) || there.host != record.host || there.port != record.port)
        return fmt::format("another gateway with the id {} is alive at {}:{}; give this one another id", record.id,
                           there.host, there.port);
    }
    impl_->drop(record.id);
    record.since_ms = config::system_clock().wall_ms();
    discovery::put(impl_->registry, impl_->options.paths.gateway(record.id), encode(record));
    discovery::put(impl_->registry, impl_->marker(record.id), "");
    impl_->tend(record, true);
    originals_logger.info("gateway {} registered from {}:{}", record.id, record.host, record.port);
    return "";
  } catch (const config::Error& e) {
    return impl_->registry_problem(e);
  }
}

std::string OriginalGateways::unregister_gateway(const GatewayId& gateway) {
  const config::MutexLock one_at_a_time(impl_->registering);
  if (!has(gateway)) return fmt::format("no gateway \"{}\" is registered here", gateway);
  try {
    for (const auto& driver : discovery::list_drivers(impl_->registry, impl_->options.paths))
      if (driver.gateway == gateway)
        discovery::remove_tree(impl_->registry, impl_->options.paths.instance(driver.name, driver.instance));
    impl_->drop(gateway);
    discovery::remove_tree(impl_->registry, impl_->options.paths.gateway(gateway));
    return "";
  } catch (const config::Error& e) {
    return impl_->registry_problem(e);
  }
}

std::string OriginalGateways::put_driver(const GatewayId& gateway, DriverRecord record) {
  const auto tended = impl_->find(gateway);
  if (!tended) return fmt::format("no gateway \"{}\" is registered here; registerSite comes first", gateway);
  if (!is_node_name(record.name) || !is_node_name(record.instance))
    return fmt::format("\"{}\" and \"{}\" cannot be a driver's name and id: not empty, no '/'", record.name,
                       record.instance);
  for (const auto& channel : record.channels)
    if (!is_node_name(channel.name)) return fmt::format("\"{}\" cannot be a channel's name", channel.name);
  record.gateway = gateway;
  record.since_ms = config::system_clock().wall_ms();
  try {
    for (const auto& known : discovery::list_drivers(impl_->registry, impl_->options.paths)) {
      if (known.instance == record.instance && known.gateway != gateway)
        return fmt::format("{} is an instance of another gateway; give this one another id", record.instance);
    }
    impl_->write_driver(record);
  } catch (const config::Error& e) {
    return impl_->registry_problem(e);
  }
  {
    const config::MutexLock lock(tended->mutex);
    tended->instances.insert(record.instance);
  }
  tended->registered.notify_all();
  return "";
}

void OriginalGateways::Impl::write_driver(const DriverRecord& record) {
  // Channels first, so that a reader that sees an active driver finds its channels.
  for (auto channel : record.channels) {
    channel.gateway = record.gateway;
    channel.driver = record.name;
    channel.instance = record.instance;
    discovery::put(registry, options.paths.channel(record.name, record.instance, channel.name), encode(channel));
  }
  discovery::put(registry, options.paths.instance(record.name, record.instance), encode(record));
}

std::string OriginalGateways::remove_driver(const GatewayId& gateway, const InstanceId& instance) {
  if (!has(gateway)) return fmt::format("no gateway \"{}\" is registered here", gateway);
  try {
    if (!impl_->remove_record(gateway, instance))
      return fmt::format("no driver instance \"{}\" on gateway {}", instance, gateway);
    return "";
  } catch (const config::Error& e) {
    return impl_->registry_problem(e);
  }
}

/// \return whether there was a record.
bool OriginalGateways::Impl::remove_record(const GatewayId& gateway, const InstanceId& instance) {
  for (const auto& driver : discovery::list_drivers(registry, options.paths)) {
    if (driver.gateway != gateway || driver.instance != instance) continue;
    discovery::remove_tree(registry, options.paths.instance(driver.name, instance));
    return true;
  }
  return false;
}

// ---------------------------------------------------------------- orders

bool OriginalGateways::has(const GatewayId& gateway) const {
  return impl_->find(gateway) != nullptr;
}

InstanceOutcome OriginalGateways::deploy(const GatewayId& gateway, const DeployRequest& request, milliseconds limit) {
  InstanceOutcome outcome{gateway, {}, OrderOutcome::failed, "the gateway is not registered any more"};
  const auto tended = impl_->find(gateway);
  if (!tended) return outcome;
  const auto deadline = std::chrono::steady_clock::now() + limit;
  const config::MutexLock one_at_a_time(tended->deploying);
  const auto before = [&] {
    const config::MutexLock lock(tended->mutex);
    return tended->instances;
  }();
  const auto answer = site_deploy(tended->site, request, limit);
  outcome.outcome = answer.outcome;
  outcome.reason = answer.text;
  if (answer.outcome != OrderOutcome::done) return outcome;
  // The original's gateway answers before it deploys, so the instance's registration decides the outcome.
  const config::MutexLock lock(tended->mutex);
  const auto is_new = [&] {
    tended->mutex.assert_held();
    for (const auto& instance : tended->instances)
      if (!before.contains(instance)) outcome.instance = instance;
    return !outcome.instance.empty();
  };
  if (tended->registered.wait_until(tended->mutex, deadline, is_new)) {
    outcome.reason.clear();
  } else {
    outcome.outcome = OrderOutcome::unknown;
    outcome.reason = "the gateway took the order, but has registered no new driver yet";
  }
  return outcome;
}

InstanceOutcome OriginalGateways::change(const GatewayId& gateway, const InstanceId& instance, InstanceAction action,
                                         milliseconds limit) {
  InstanceOutcome outcome{gateway, instance, OrderOutcome::failed, "the gateway is not registered any more"};
  const auto tended = impl_->find(gateway);
  if (!tended) return outcome;
  const auto answer = site_change(tended->site, instance, action, limit);
  outcome.outcome = answer.outcome;
  outcome.reason = answer.outcome == OrderOutcome::done ? "" : answer.text;
  if (answer.outcome != OrderOutcome::done) return outcome;
  try {
    if (action == InstanceAction::undeploy) {
      impl_->remove_record(gateway, instance);  // the gateway may have removed it already
      return outcome;
    }
    for (auto driver : discovery::list_drivers(impl_->registry, impl_->options.paths)) {
      if (driver.gateway != gateway || driver.instance != instance) continue;
      driver.state = action == InstanceAction::start ? DriverState::active : DriverState::inactive;
      driver.since_ms = config::system_clock().wall_ms();
      impl_->write_driver(driver);
    }
  } catch (const config::Error& e) {
    outcome.reason = fmt::format("the gateway has done it, but its record is old: {}", e.what());
  }
  return outcome;
}

}  // namespace iotcloud::master
