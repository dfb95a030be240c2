#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/gateway/host/lease.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/gateway/ordered_instances.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::gateway {

using discovery::DriverRecord;
using discovery::DriverState;
using discovery::OrderRecord;
using std::chrono::milliseconds;

namespace {

/// Whether a running instance must be replaced to follow the new order.
bool differs_in_making(const OrderRecord& a, const OrderRecord& b) {
  // A host keeps what it was given, so it would say that a rule made what a master has ordered since.
  return a.driver != b.driver || a.version() != b.version() || a.properties != b.properties ||
         a.made_by.empty() != b.made_by.empty();
}

}  // namespace

OrderedInstances::OrderedInstances(Options options, EventLoop& loop)
    : options_(std::move(options)),
      records_(*options_.registry, options_.paths),
      changes_(most_changes, options_.history_file),
      fleet_(loop, *options_.launcher, Placement(options_.brokers),
             {options_.gateway, options_.restart, options_.clock},
             [this](const InstanceStatus& status) { heard(status); }) {}

void OrderedInstances::adopt() {
  for (const auto& found : fleet_.adopt()) {
    auto& entry = entries_[found.spec.order.instance];
    entry.order = found.spec.order;
    entry.status = found.status;
    entry.in_fleet = true;
    entry.adopted = true;
  }
}

void OrderedInstances::publish_adopted() {
  for (const auto& [instance, entry] : entries_) {
    if (entry.adopted && entry.order_version == -1) publish_record(entry);
  }
}

std::set<discovery::InstanceId> OrderedInstances::present() const {
  std::set<discovery::InstanceId> present;
  for (const auto& [instance, entry] : entries_) {
    const bool is_ordered = (entry.next ? *entry.next : entry.order).made_by.empty();
    if (is_ordered && (!entry.removing || entry.next)) present.insert(instance);
  }
  return present;
}

std::set<discovery::InstanceId> OrderedInstances::without_record(
    const std::set<discovery::InstanceId>& instances) const {
  std::vector<discovery::InstanceId> asked;
  std::vector<std::string> paths;
  for (const auto& instance : instances) {
    const auto found = entries_.find(instance);
    if (found == entries_.end() || !(found->second.adopted || records_.has_written(instance))) continue;
    asked.push_back(instance);
    paths.push_back(options_.paths.instance(found->second.status.driver, instance));
  }
  const auto nodes = options_.registry->get_all(paths);
  std::set<discovery::InstanceId> without;
  for (std::size_t i = 0; i < asked.size(); ++i) {
    if (!nodes[i]) without.insert(asked[i]);
  }
  return without;
}

void OrderedInstances::ordered_at_first(const std::set<discovery::InstanceId>& names) {
  unread_ = names;
  remove_stale_records(names);
  std::vector<discovery::InstanceId> not_ordered;
  for (const auto& [instance, entry] : entries_) {
    if (!names.contains(instance) && entry.order.made_by.empty()) not_ordered.push_back(instance);
  }
  for (const auto& instance : not_ordered) forget(instance);
}

void OrderedInstances::follow(const OrderRecord& order, std::int64_t version) {
  if (unread_) unread_->erase(order.instance);
  const auto found = entries_.find(order.instance);
  if (found == entries_.end()) {
    create(order, version);
    return;
  }
  Entry& entry = found->second;
  const bool first_sight = std::exchange(entry.order_version, version) == -1;
  bring_to(entry, order, !first_sight);
}

void OrderedInstances::provision(const OrderRecord& order, bool again) {
  const auto found = entries_.find(order.instance);
  if (found == entries_.end()) {
    create(order, -1);
  } else {
    found->second.order_version = -1;
    bring_to(found->second, order, again);
  }
}

std::set<discovery::InstanceId> OrderedInstances::left_by_rules() const {
  std::set<discovery::InstanceId> left;
  for (const auto& [instance, entry] : entries_) {
    if (entry.adopted && !entry.order.made_by.empty() && !(unread_ && unread_->contains(instance)))
      left.insert(instance);
  }
  return left;
}

/// Changes how an instance runs. \param again start it again if it failed
void OrderedInstances::bring_to(Entry& entry, const OrderRecord& order, bool again) {
  const bool failed = entry.status.state == DriverState::failed;
  const bool to_start_again = failed && order.active && again;
  if (entry.removing || to_start_again || differs_in_making(entry.order, order)) {
    replace(entry, order);
    return;
  }
  const bool was_active = std::exchange(entry.order, order).active;
  if (order.active != was_active && entry.in_fleet) {
    order.active ? fleet_.activate(order.instance) : fleet_.deactivate(order.instance);
  }
  publish_record(entry);  // the order's metadata may have changed, and an adopted instance's record may be out of date
}

void OrderedInstances::create(const OrderRecord& order, std::int64_t version) {
  auto& entry = entries_[order.instance];
  entry.order = order;
  entry.order_version = version;
  entry.removing = false;
  entry.next.reset();
  entry.status = {};
  entry.status.instance = order.instance;
  entry.status.driver = order.driver;
  try {
    check_name("instance id", order.instance);
    check_plugin_file_name(order.plugin);
    if (!order.driver.empty()) check_name("driver name", order.driver);
    if (!order.sha256.empty() && !security::is_sha256(order.sha256))
      throw config::Error("its order names a plugin by \"" + order.sha256 + "\", which is no SHA-256");
    check_lease(order.properties, options_.session_timeout);
  } catch (const config::Error& e) {
    refuse(entry, e.what());
    return;
  }
  entry.in_fleet = true;
  fleet_.create(order);
}

bool OrderedInstances::leased() const {
  return std::any_of(entries_.begin(), entries_.end(), [](const auto& entry) {
    return entry.second.in_fleet && entry.second.order.properties.contains("lease");
  });
}

/// Rejects an invalid order: the instance's record says `failed` with the reason, and no host is involved.
void OrderedInstances::refuse(Entry& entry, const std::string& reason) {
  entry.in_fleet = false;
  entry.status.state = DriverState::failed;
  entry.status.reason = reason;
  entry.status.since_ms = options_.clock->wall_ms();
  logger.error("the order for {} cannot be followed: {}", entry.order.instance, reason);
  try {
    check_name("driver name", entry.status.driver);
  } catch (const config::Error&) {
    entry.status.driver = discovery::DriverName("unknown");  // the record's path contains the driver's name
  }
  publish_record(entry);
}

void OrderedInstances::replace(Entry& entry, const OrderRecord& order) {
  if (!entry.in_fleet) {
    create(order, entry.order_version);
    return;
  }
  entry.next = order;
  if (!std::exchange(entry.removing, true)) fleet_.remove(order.instance, Removal::replaced);
}

void OrderedInstances::forget(const discovery::InstanceId& instance) {
  if (unread_) unread_->erase(instance);
  const auto found = entries_.find(instance);
  if (found == entries_.end()) return;
  Entry& entry = found->second;
  entry.next.reset();
  if (entry.in_fleet) {
    if (!std::exchange(entry.removing, true)) fleet_.remove(instance, Removal::undeployed);
    return;
  }
  const discovery::DriverName driver = entry.status.driver;
  entries_.erase(found);
  drop_record(driver, instance);
}

void OrderedInstances::heard(const InstanceStatus& status) {
  const auto found = entries_.find(status.instance);
  if (found == entries_.end()) return;
  Entry& entry = found->second;
  entry.status = status;
  if (status.state != DriverState::undeployed) {
    publish_record(entry);
    return;
  }
  entry.in_fleet = false;
  if (stopping_) {
    entry.status.state = DriverState::inactive;
    entry.status.reason = "its gateway was stopped";
    publish_record(entry);
  } else if (entry.next) {
    create(OrderRecord(*entry.next), entry.order_version);
  } else {
    entries_.erase(found);
    drop_record(status.driver, status.instance);
  }
}

DriverRecord OrderedInstances::record_for(const Entry& entry) const {
  DriverRecord record;
  record.name = entry.status.driver;
  record.instance = entry.order.instance;
  record.gateway = options_.gateway;
  record.state = entry.status.state;
  record.reason = entry.status.reason;
  record.since_ms = entry.status.since_ms;
  record.metadata = entry.status.metadata;
  // insert() keeps the driver's own entries
  record.metadata.insert(entry.order.metadata.begin(), entry.order.metadata.end());
  record.channels = entry.status.channels;
  record.deployment = entry.order.name;
  record.made_by = entry.order.made_by;
  record.index = entry.order.index;
  record.plugin = entry.order.plugin;
  record.sha256 = entry.order.sha256.empty() ? entry.status.plugin.sha256 : entry.order.sha256;
  record.signed_by = entry.status.plugin.signed_by;
  record.starts_again = entry.status.starts_again;
  return record;
}

void OrderedInstances::publish_record(const Entry& entry) {
  const auto record = record_for(entry);
  const bool changed = [&] {
    const config::MutexLock lock(mutex_);
    const auto& told = told_[record.instance].record;
    return told.state != record.state || told.reason != record.reason || told.since_ms != record.since_ms;
  }();
  // The change is added to the log, and all() shows it, before the record is written: whoever sees the record finds
  // both. add() writes to the disk, so the mutex is not held meanwhile.
  if (changed) changes_.add({record.instance, record.name, record.state, record.reason, record.since_ms});
  {
    const config::MutexLock lock(mutex_);
    told_[record.instance] = {record, entry.order_version, false};
  }
  records_.put(record);
  {
    const config::MutexLock lock(mutex_);
    told_[record.instance].given_to_writer = true;
  }
  changed_.notify_all();
}

void OrderedInstances::drop_record(const discovery::DriverName& driver, const discovery::InstanceId& instance) {
  const bool known = [&] {
    const config::MutexLock lock(mutex_);
    return told_.contains(instance);
  }();
  if (known) changes_.add({instance, driver, DriverState::undeployed, "as ordered", options_.clock->wall_ms()});
  records_.erase(driver, instance);
  {
    const config::MutexLock lock(mutex_);
    told_.erase(instance);
  }
  changed_.notify_all();
}

void OrderedInstances::stop(milliseconds limit, std::function<void()> done) {
  stopping_ = true;
  fleet_.shutdown(limit, [this, done = std::move(done)] {
    records_.flush();
    changes_.sync();
    done();
  });
}

void OrderedInstances::abandon(milliseconds limit, std::function<void()> done) {
  records_.close();
  stop(limit, std::move(done));
}

/// Removes records of instances whose orders were removed while no gateway ran, and tells the writer of the others: an
/// instance may have had another driver's name when its record was written.
void OrderedInstances::remove_stale_records(const std::set<discovery::InstanceId>& ordered) {
  try {
    for (const auto& record : discovery::list_drivers(*options_.registry, options_.paths)) {
      if (record.gateway != options_.gateway) continue;
      records_.found(record.name, record.instance);
      if (ordered.contains(record.instance)) continue;
      if (entries_.contains(record.instance)) continue;  // the instance runs: forget() removes its record
      logger.info("removing the record of {} {}: it is not ordered any more", record.name, record.instance);
      records_.erase(record.name, record.instance);
    }
  } catch (const config::Error& e) {
    logger.warn("records that this gateway wrote before it was started again may have stayed: {}", e.what());
  }
}

std::optional<std::set<std::string>> OrderedInstances::plugins_named() const {
  if (!unread_ || !unread_->empty()) return std::nullopt;
  std::set<std::string> named;
  const auto name = [&](const OrderRecord& order) {
    named.insert(order.sha256);
    if (order.previous) named.insert(order.previous->sha256);
  };
  for (const auto& [instance, entry] : entries_) {
    name(entry.order);
    if (entry.next) name(*entry.next);
  }
  return named;
}

std::vector<DriverRecord> OrderedInstances::all() const {
  const config::MutexLock lock(mutex_);
  std::vector<DriverRecord> all;
  for (const auto& [instance, told] : told_) all.push_back(told.record);
  return all;
}

OrderedInstances::AwaitedRecord OrderedInstances::wait_for(const discovery::InstanceId& instance,
                                                           const Condition& condition, milliseconds limit,
                                                           std::int64_t order_version) const {
  const config::MutexLock lock(mutex_);
  AwaitedRecord outcome;
  outcome.known = changed_.wait_for(mutex_, limit, [&]() IOTCLOUD_REQUIRES(mutex_) {
    const auto found = told_.find(instance);
    outcome.record.reset();
    if (found == told_.end()) return condition(outcome.record);
    outcome.record = found->second.record;
    return found->second.given_to_writer && found->second.order_version >= order_version && condition(outcome.record);
  });
  return outcome;
}

}  // namespace iotcloud::gateway
