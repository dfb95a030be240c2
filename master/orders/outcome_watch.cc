#include <fmt/format.h>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/orders/outcome_watch.h>

namespace iotcloud::master {

using discovery::DriverName;
using discovery::DriverState;
using discovery::InstanceId;
using discovery::Node;

OutcomeWatch::OutcomeWatch(discovery::Registry& registry, const discovery::Paths& paths, Wanted wanted)
    : registry_(registry), paths_(paths), wanted_(wanted) {}

OutcomeWatch::OutcomeWatch(discovery::Registry& registry, const discovery::Paths& paths, MetadataChanges changes)
    : registry_(registry), paths_(paths), wanted_(Wanted::described), changes_(std::move(changes)) {}

OutcomeWatch::~OutcomeWatch() {
  // Runs without the lock, because a guard's destructor waits for its callback, which may take the lock. The guard of
  // the names goes first, because its callback adds record guards.
  names_guard_.reset();
  record_guards_.clear();
}

namespace {

bool runs(const discovery::DriverRecord& record, const AwaitedVersion& version) {
  if (record.plugin != version.plugin) return false;
  return version.sha256.empty() ? version.not_sha256.empty() || record.sha256 != version.not_sha256
                                : record.sha256 == version.sha256;
}

}  // namespace

void OutcomeWatch::expect(const InstanceId& instance, const DriverName& driver, const std::optional<Node>& before,
                          AwaitedVersion version) {
  std::vector<DriverName> names;
  {
    config::MutexLock lock(mutex_);
    auto& expected = expected_[instance];
    if (before) expected.before = {before->created, before->version};
    if (before && (wanted_ == Wanted::anew || version.anew)) {
      if (const auto record = discovery::driver_of(before, paths_.instance(driver, instance)))
        expected.state_before = {record->state, record->since_ms};
    }
    expected.version = std::move(version);
    ++open_;
    if (driver.empty()) {
      anywhere_.insert(instance);
      names.assign(driver_names_.begin(), driver_names_.end());
    } else {
      names.push_back(driver);
    }
  }
  for (const auto& name : names) watch_record(name, instance);
  if (driver.empty() && !names_guard_) {
    names_guard_ = registry_.watch_children(paths_.sensors, [this](const auto& children) {
      if (children) on_driver_names(*children);
    });
  }
}

void OutcomeWatch::watch_record(const DriverName& driver, const InstanceId& instance) {
  const auto path = paths_.instance(driver, instance);
  auto guard = registry_.watch_node(
      path, [this, path, instance](const std::optional<Node>& node) { on_record(path, instance, node); });
  config::MutexLock lock(mutex_);
  record_guards_.push_back(std::move(guard));
}

void OutcomeWatch::on_driver_names(const std::vector<std::string>& names) {
  std::vector<std::pair<DriverName, InstanceId>> wanted;
  {
    config::MutexLock lock(mutex_);
    for (const auto& child : names) {
      const DriverName name(child);
      if (!driver_names_.insert(name).second) continue;
      for (const auto& instance : anywhere_) wanted.emplace_back(name, instance);
    }
  }
  for (const auto& [name, instance] : wanted) watch_record(name, instance);
}

void OutcomeWatch::on_record(const std::string& path, const InstanceId& instance, const std::optional<Node>& node) {
  config::MutexLock lock(mutex_);
  auto& expected = expected_[instance];
  if (expected.outcome) return;
  expected.outcome = judge(expected, path, node);
  if (!expected.outcome) return;
  --open_;
  changed_.notify_all();
}

std::optional<ReasonedOutcome> OutcomeWatch::judge(Expected& expected, const std::string& path,
                                                   const std::optional<Node>& node) const {
  const ReasonedOutcome done{OrderOutcome::done, ""};
  if (!node || node->data.empty()) {
    // An instance being deployed has no record under this driver's name, or has none yet.
    return wanted_ == Wanted::gone ? std::optional(done) : std::nullopt;
  }
  discovery::DriverRecord record;
  try {
    record = discovery::decode_driver(node->data, path);
  } catch (const config::Error& e) {
    expected.last_state = fmt::format("its record cannot be read: {}", e.what());
    return std::nullopt;
  }
  if (wanted_ == Wanted::described) {
    if (expected.before == std::pair(node->created, node->version)) return std::nullopt;
    return judge_metadata(expected, record);
  }
  if (expected.state_before == std::pair(record.state, record.since_ms)) return std::nullopt;
  expected.last_state =
      fmt::format("last state: {}{}{}", to_string(record.state), record.reason.empty() ? "" : ", ", record.reason);
  const bool updated = wanted_ == Wanted::updated;
  if (updated && !runs(record, expected.version)) {
    expected.last_state = fmt::format("it does not run {} yet; {}", expected.version.plugin, expected.last_state);
    return std::nullopt;
  }
  switch (record.state) {
    case DriverState::active:
      return wanted_ == Wanted::active || wanted_ == Wanted::anew || (updated && expected.version.active)
                 ? std::optional(done)
                 : std::nullopt;
    case DriverState::inactive:
      return wanted_ == Wanted::inactive || wanted_ == Wanted::anew || (updated && !expected.version.active)
                 ? std::optional(done)
                 : std::nullopt;
    case DriverState::undeployed:
      if (wanted_ == Wanted::gone) return done;
      return ReasonedOutcome{OrderOutcome::failed, "it was undeployed meanwhile"};
    case DriverState::failed:
      if (expected.before == std::pair(node->created, node->version)) return std::nullopt;
      return ReasonedOutcome{OrderOutcome::failed,
                             record.reason.empty() ? "the gateway gave no reason" : record.reason};
    case DriverState::deployed:
    case DriverState::starting:
    case DriverState::stopping:
    case DriverState::ordered:
      return std::nullopt;
  }
  return std::nullopt;
}

std::optional<ReasonedOutcome> OutcomeWatch::judge_metadata(Expected& expected,
                                                            const discovery::DriverRecord& record) const {
  for (const auto& [key, value] : changes_) {
    const auto found = record.metadata.find(key);
    if (found == record.metadata.end() ? value.empty() : found->second == value) continue;
    expected.last_state =
        found == record.metadata.end()
            ? fmt::format("its record has no {} yet", key)
            : fmt::format("its record says {}={}; what the driver itself reports takes precedence", key, found->second);
    return std::nullopt;
  }
  return ReasonedOutcome{OrderOutcome::done, ""};
}

std::map<InstanceId, ReasonedOutcome> OutcomeWatch::wait(std::chrono::milliseconds limit, const std::stop_token& stop) {
  const config::MutexLock lock(mutex_);
  changed_.wait_for(mutex_, stop, limit, [this]() IOTCLOUD_REQUIRES(mutex_) { return open_ == 0; });
  std::map<InstanceId, ReasonedOutcome> outcomes;
  for (const auto& [instance, expected] : expected_) {
    outcomes[instance] = expected.outcome
                             ? *expected.outcome
                             : without_report(registry_, limit, stop.stop_requested(), expected.last_state);
  }
  return outcomes;
}

}  // namespace iotcloud::master
