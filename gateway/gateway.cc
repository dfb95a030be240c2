#include <condition_variable>
#include <future>
#include <map>
#include <mutex>
#include <set>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/directory.h>
#include <iotcloud/gateway/gateway.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/gateway/membership.h>
#include <iotcloud/gateway/record_writer.h>

namespace iotcloud::gateway {

using discovery::DriverRecord;
using discovery::DriverState;
using discovery::OrderRecord;
using std::chrono::milliseconds;

namespace {

constexpr config::Logger log{"gateway"};
constexpr milliseconds retry_pause{1000};
constexpr milliseconds taken_pause{250};
constexpr milliseconds record_share_of_stop{500};

/// Whether a running instance must be replaced to follow the new order.
bool differs_in_making(const OrderRecord& a, const OrderRecord& b) {
  return a.driver != b.driver || a.plugin != b.plugin || a.properties != b.properties;
}

const config::Clock& clock_of(const GatewayOptions& options) {
  return options.clock != nullptr ? *options.clock : config::system_clock();
}

discovery::GatewayRecord record_of(const GatewayOptions& options) {
  discovery::GatewayRecord record;
  record.id = options.id;
  record.host = options.host;
  record.port = options.port;
  for (const auto& broker : options.brokers) record.brokers.push_back(broker.name);
  record.since_ms = clock_of(options).wall_ms();
  return record;
}

}  // namespace

struct Gateway::Impl {
  /// One ordered instance. `in_fleet`: a host knows it, so its end will be reported.
  struct Entry {
    OrderRecord order;
    std::int64_t order_version = -1;
    std::int64_t order_created = 0;  ///< with the version: which writing of the order this is
    InstanceStatus status;
    bool in_fleet = false;
    bool removing = false;
    std::optional<OrderRecord> next;  ///< to be made when the present one is gone
  };

  /// What wait_for() sees of an instance.
  struct Told {
    DriverRecord record;
    std::int64_t order_version = -1;
  };

  explicit Impl(GatewayOptions given)
      : options(std::move(given)),
        clock(clock_of(options)),
        membership(*options.registry, options.paths,
                   {record_of(options), options.state_id, options.session_timeout, &clock}),
        records(*options.registry, options.paths),
        loop("gateway"),
        fleet(loop, *options.launcher, Placement(options.brokers), {options.id, options.restart, &clock},
              [this](const InstanceStatus& status) { heard(status); }) {}

  // Everything below runs on the loop unless it says otherwise.
  void join(const std::shared_ptr<std::promise<std::string>>& first);
  void joined();
  void names_changed(const std::set<std::string>& names);
  void order_changed(const std::string& instance, const std::optional<discovery::Node>& node);
  void apply(const OrderRecord& order, std::int64_t version);
  void create(const OrderRecord& order);
  void replace(Entry& entry, const OrderRecord& order);
  void forget(const std::string& instance);
  void heard(const InstanceStatus& status);
  void refuse(Entry& entry, const std::string& reason);
  void publish_record(const Entry& entry);
  void drop_record(const std::string& driver, const std::string& instance);
  void remove_stale_records(const std::set<std::string>& ordered);
  DriverRecord record_for(const Entry& entry) const;
  void stop_orders();
  void finish_stop(const std::shared_ptr<std::promise<void>>& done);

  const GatewayOptions options;
  const config::Clock& clock;
  Membership membership;
  RecordWriter records;
  std::map<std::string, Entry> entries;
  std::set<std::string> initial;  ///< orders that stood when the gateway came: theirs may be older epochs
  bool orders_known = false;
  bool told_away = false;
  bool told_taken = false;
  bool stopping = false;
  std::map<std::string, discovery::GuardPtr> order_watches;
  discovery::GuardPtr names_watch, session_listener;

  mutable std::mutex mutex;
  mutable std::condition_variable changed;
  std::map<std::string, Told> told;  ///< guarded by mutex
  std::int64_t epoch = 0;            ///< guarded by mutex
  bool started = false;              ///< guarded by mutex
  bool stopped = false;              ///< guarded by mutex

  EventLoop loop;   ///< near the end: nothing runs on it when the above dies
  HostFleet fleet;  ///< dies first: its links' last events are posted to the loop
};

Gateway::Gateway(GatewayOptions options) {
  check_name("gateway id", options.id);
  for (const auto& broker : options.brokers) {
    if (broker.options.urls.empty()) {
      throw config::Error(fmt::format("the broker \"{}\" has no urls; give at least one", broker.name));
    }
  }
  impl_ = std::make_unique<Impl>(std::move(options));
}

Gateway::~Gateway() {
  stop(milliseconds{5000});
  // First nothing runs on the loop any more, then what posts to it goes, then the loop itself.
  impl_->loop.stop();
  impl_->stop_orders();
}

const std::string& Gateway::id() const {
  return impl_->options.id;
}

void Gateway::start() {
  {
    const std::lock_guard lock(impl_->mutex);
    impl_->started = true;
  }
  auto first = std::make_shared<std::promise<std::string>>();
  auto outcome = first->get_future();
  impl_->loop.post([impl = impl_.get(), first] {
    for (const auto& found : impl->fleet.adopt()) {
      auto& entry = impl->entries[found.spec.order.instance];
      entry.order = found.spec.order;
      entry.status = found.status;
      entry.in_fleet = true;
    }
    impl->join(first);
  });
  const std::string refusal = outcome.get();
  if (!refusal.empty()) throw config::Error(refusal);
}

/// \param first told of the outcome of start(), empty or why it failed; null once the gateway counts as started.
void Gateway::Impl::join(const std::shared_ptr<std::promise<std::string>>& first) try {
  const auto again = [&](milliseconds pause, const std::shared_ptr<std::promise<std::string>>& waiting) {
    loop.start_timer(pause, milliseconds{0}, [this, waiting] {
      if (!stopping) join(waiting);
    });
  };
  switch (membership.join()) {
    case Membership::Result::joined:
      joined();
      if (first) first->set_value("");
      return;
    case Membership::Result::away:
      if (!told_away) log.warn("the registry is away; the gateway {} registers when it comes", options.id);
      told_away = true;
      if (first) first->set_value("");
      again(retry_pause, nullptr);
      return;
    case Membership::Result::taken:
      break;
  }
  if (membership.hopeless()) {
    const std::string taken = fmt::format(
        "another gateway with the id \"{}\" is alive ({}); give this one an id of its own, or stop the other",
        options.id, membership.incumbent());
    if (first) {
      first->set_value(taken);
      return;
    }
    if (!std::exchange(told_taken, true)) log.error("{}; until then this gateway follows no orders", taken);
  }
  again(taken_pause, first);
} catch (const std::exception& e) {
  log.error("the gateway cannot register: {}", e.what());
  if (first) first->set_value(e.what());
}

void Gateway::Impl::joined() {
  log.info("the gateway {} is registered", options.id);
  // Callbacks come on the registry's dispatcher; they only post.
  session_listener = options.registry->on_session([this](discovery::SessionState state) {
    if (state == discovery::SessionState::connected) loop.post([this] { records.flush(); });
  });
  loop.start_timer(retry_pause, retry_pause, [this] { records.flush(); });
  names_watch = options.registry->watch_children(options.paths.orders(options.id),
                                                 [this](const std::optional<std::vector<std::string>>& names) {
                                                   std::set<std::string> now;
                                                   if (names) now.insert(names->begin(), names->end());
                                                   loop.post([this, now] { names_changed(now); });
                                                 });
}

void Gateway::Impl::names_changed(const std::set<std::string>& names) {
  if (stopping) return;
  if (!std::exchange(orders_known, true)) {
    initial = names;
    remove_stale_records(names);
    std::vector<std::string> not_ordered;
    for (const auto& [instance, entry] : entries) {
      if (!names.contains(instance)) not_ordered.push_back(instance);
    }
    for (const auto& instance : not_ordered) forget(instance);
  }
  for (const auto& name : names) {
    if (order_watches.contains(name)) continue;
    order_watches[name] = options.registry->watch_node(options.paths.order(options.id, name),
                                                       [this, name](const std::optional<discovery::Node>& node) {
                                                         loop.post([this, name, node] { order_changed(name, node); });
                                                       });
  }
  for (auto it = order_watches.begin(); it != order_watches.end();) {
    if (names.contains(it->first)) {
      ++it;
      continue;
    }
    const std::string instance = it->first;
    it = order_watches.erase(it);
    forget(instance);
  }
}

void Gateway::Impl::order_changed(const std::string& instance, const std::optional<discovery::Node>& node) {
  if (stopping || !node) return;  // its going is seen by its name's going
  const auto entry = entries.find(instance);
  if (entry != entries.end() && entry->second.order_version == node->version &&
      entry->second.order_created == node->created) {
    return;
  }
  try {
    const auto order = discovery::decode_order(node->data, options.paths.order(options.id, instance));
    if (order.instance != instance) {
      throw config::Error(fmt::format("the order at {} is for the instance \"{}\"",
                                      options.paths.order(options.id, instance), order.instance));
    }
    const bool stood_before = initial.erase(instance) > 0;
    {
      const std::lock_guard lock(mutex);
      if (order.epoch < epoch && !stood_before) {
        log.warn("an order for {} is ignored: its epoch {} is older than {}, its master leads no more", instance,
                 order.epoch, epoch);
        return;
      }
      epoch = std::max(epoch, order.epoch);
    }
    apply(order, node->version);
    if (const auto followed = entries.find(instance); followed != entries.end()) {
      followed->second.order_created = node->created;
    }
  } catch (const std::exception& e) {
    log.error("an order is ignored: {}", e.what());
  }
}

void Gateway::Impl::apply(const OrderRecord& order, std::int64_t version) {
  const auto found = entries.find(order.instance);
  if (found == entries.end()) {
    create(order);
    const auto made = entries.find(order.instance);
    if (made != entries.end()) made->second.order_version = version;
    return;
  }
  Entry& entry = found->second;
  const bool first_sight = std::exchange(entry.order_version, version) == -1;
  const bool failed = entry.status.state == DriverState::failed;
  const bool to_start_again = failed && order.active && !first_sight;
  if (entry.removing || to_start_again || differs_in_making(entry.order, order)) {
    replace(entry, order);
    return;
  }
  const bool was_active = std::exchange(entry.order, order).active;
  if (order.active != was_active && entry.in_fleet) {
    order.active ? fleet.activate(order.instance) : fleet.deactivate(order.instance);
  }
  publish_record(entry);  // its metadata may have changed; an adopted instance's record may be old
}

void Gateway::Impl::create(const OrderRecord& order) {
  auto& entry = entries[order.instance];
  entry.order = order;
  entry.removing = false;
  entry.next.reset();
  entry.status = {};
  entry.status.instance = order.instance;
  entry.status.driver = order.driver;
  try {
    check_name("instance id", order.instance);
    check_plugin_file_name(order.plugin);
    if (!order.driver.empty()) check_name("driver name", order.driver);
  } catch (const config::Error& e) {
    refuse(entry, e.what());
    return;
  }
  entry.in_fleet = true;
  fleet.create(order);
}

/// An order that cannot be followed: told in the record, no host is bothered.
void Gateway::Impl::refuse(Entry& entry, const std::string& reason) {
  entry.in_fleet = false;
  entry.status.state = DriverState::failed;
  entry.status.reason = reason;
  entry.status.since_ms = clock.wall_ms();
  log.error("the order for {} cannot be followed: {}", entry.order.instance, reason);
  try {
    check_name("driver name", entry.status.driver);
  } catch (const config::Error&) {
    entry.status.driver = "unknown";  // the record needs a place that exists
  }
  publish_record(entry);
}

void Gateway::Impl::replace(Entry& entry, const OrderRecord& order) {
  if (!entry.in_fleet) {
    const auto version = entry.order_version;
    create(order);
    entry.order_version = version;
    return;
  }
  entry.next = order;
  if (!std::exchange(entry.removing, true)) fleet.remove(order.instance);
}

void Gateway::Impl::forget(const std::string& instance) {
  const auto found = entries.find(instance);
  if (found == entries.end()) return;
  Entry& entry = found->second;
  entry.next.reset();
  if (entry.in_fleet) {
    if (!std::exchange(entry.removing, true)) fleet.remove(instance);
    return;
  }
  const std::string driver = entry.status.driver;
  entries.erase(found);
  drop_record(driver, instance);
}

void Gateway::Impl::heard(const InstanceStatus& status) {
  const auto found = entries.find(status.instance);
  if (found == entries.end()) return;
  Entry& entry = found->second;
  entry.status = status;
  if (status.state != DriverState::undeployed) {
    publish_record(entry);
    return;
  }
  entry.in_fleet = false;
  if (stopping) {
    entry.status.state = DriverState::inactive;
    entry.status.reason = "its gateway was stopped";
    publish_record(entry);
  } else if (entry.next) {
    const auto version = entry.order_version;
    create(OrderRecord(*entry.next));
    entry.order_version = version;
  } else {
    entries.erase(found);
    drop_record(status.driver, status.instance);
  }
}

DriverRecord Gateway::Impl::record_for(const Entry& entry) const {
  DriverRecord record;
  record.name = entry.status.driver;
  record.instance = entry.order.instance;
  record.gateway = options.id;
  record.state = entry.status.state;
  record.reason = entry.status.reason;
  record.since_ms = entry.status.since_ms;
  record.metadata = entry.status.metadata;
  record.metadata.insert(entry.order.metadata.begin(), entry.order.metadata.end());  // the driver's own go before
  record.channels = entry.status.channels;
  return record;
}

void Gateway::Impl::publish_record(const Entry& entry) {
  const auto record = record_for(entry);
  records.put(record);
  {
    const std::lock_guard lock(mutex);
    told[record.instance] = {record, entry.order_version};
  }
  changed.notify_all();
}

void Gateway::Impl::drop_record(const std::string& driver, const std::string& instance) {
  records.erase(driver, instance);
  {
    const std::lock_guard lock(mutex);
    told.erase(instance);
  }
  changed.notify_all();
}

/// Records of an earlier life whose orders went while no gateway was there to see it.
void Gateway::Impl::remove_stale_records(const std::set<std::string>& ordered) {
  try {
    for (const auto& record : discovery::list_drivers(*options.registry, options.paths)) {
      if (record.gateway != options.id || ordered.contains(record.instance)) continue;
      if (entries.contains(record.instance)) continue;  // it runs: forget() will see to it
      log.info("removing the record of {} {}: it is not ordered any more", record.name, record.instance);
      records.erase(record.name, record.instance);
    }
  } catch (const config::Error& e) {
    log.warn("records of an earlier life of this gateway may have stayed: {}", e.what());
  }
}

void Gateway::stop(milliseconds limit) {
  {
    const std::lock_guard lock(impl_->mutex);
    if (!impl_->started || impl_->stopped) return;
    impl_->stopped = true;
  }
  const auto deadline = std::chrono::steady_clock::now() + limit;
  auto done = std::make_shared<std::promise<void>>();
  auto over = done->get_future();
  const auto for_hosts = std::max(limit - record_share_of_stop, limit / 2);
  impl_->loop.post([impl = impl_.get(), for_hosts, done] {
    impl->stop_orders();
    impl->fleet.shutdown(for_hosts, [impl, done] { impl->finish_stop(done); });
  });
  if (over.wait_until(deadline) != std::future_status::ready) {
    log.error("not everything stopped within {} ms", limit.count());
  }
}

void Gateway::Impl::stop_orders() {
  stopping = true;
  names_watch.reset();
  order_watches.clear();
  session_listener.reset();
}

void Gateway::Impl::finish_stop(const std::shared_ptr<std::promise<void>>& done) {
  records.flush();
  membership.leave();
  log.info("the gateway {} has stopped", options.id);
  done->set_value();
}

std::int64_t Gateway::epoch() const {
  const std::lock_guard lock(impl_->mutex);
  return impl_->epoch;
}

std::vector<DriverRecord> Gateway::instances() const {
  const std::lock_guard lock(impl_->mutex);
  std::vector<DriverRecord> all;
  for (const auto& [instance, told] : impl_->told) all.push_back(told.record);
  return all;
}

Gateway::Outcome Gateway::wait_for(const std::string& instance, const Condition& condition, milliseconds limit,
                                   std::int64_t order_version) const {
  std::unique_lock lock(impl_->mutex);
  Outcome outcome;
  outcome.known = impl_->changed.wait_for(lock, limit, [&] {
    const auto found = impl_->told.find(instance);
    outcome.record.reset();
    if (found == impl_->told.end()) return condition(outcome.record);
    outcome.record = found->second.record;
    return found->second.order_version >= order_version && condition(outcome.record);
  });
  return outcome;
}

}  // namespace iotcloud::gateway
