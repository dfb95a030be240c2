// A rolling update of plugins, properties or both: changes instances step by step, and rolls all of them back when a
// step fails.
#include <algorithm>
#include <chrono>
#include <map>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/master/logger.h>
#include <iotcloud/master/orders/order_kind.h>
#include <iotcloud/master/orders/updates.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master {

using discovery::DriverState;
using discovery::GatewayStatus;
using discovery::InstanceId;
using discovery::OrderRecord;
using discovery::PluginVersion;

namespace {

constexpr std::chrono::milliseconds settle_pause{200};
constexpr std::chrono::milliseconds longest_settle{600'000};

std::string name_of(const PluginVersion& version) {
  return version.sha256.empty() ? version.file
                                : fmt::format("{} ({})", version.file, security::short_sha256(version.sha256));
}

/// One update, used by one thread.
class RollingUpdate {
 public:
  RollingUpdate(OrderDesk& desk, InstancesUnderUpdate& under_update, const UpdateRequest& request)
      : desk_(desk), under_update_(under_update), request_(request), wanted_{request.plugin, request.sha256} {
    for (const auto& each : request.properties) properties_[each.instance] = &each.properties;
  }
  ~RollingUpdate() {
    const config::MutexLock lock(under_update_.mutex);
    for (const auto& instance : reserved_) under_update_.ids.erase(instance);
  }
  RollingUpdate(const RollingUpdate&) = delete;
  RollingUpdate& operator=(const RollingUpdate&) = delete;

  OrderResult run();

 private:
  using Texts = std::map<std::string, std::string>;
  struct UpdatedInstance {
    LocatedInstance where;
    InstanceOutcome outcome;
    discovery::DriverRecord record;  ///< before the update
    PluginVersion before;
    Texts properties_before;
    PluginVersion wanted;
    const Texts* properties = nullptr;  ///< wanted; nullptr: they stay
    bool active = true;                 ///< the ordered state
    bool ordered = false;               ///< the change was written into its order, or may have been
  };
  using Instances = std::vector<UpdatedInstance>;
  using Step = std::pair<Instances::iterator, Instances::iterator>;

  std::optional<OrderResult> prepare();
  std::string obstacle(UpdatedInstance& updated, const std::vector<GatewayStatus>& known);
  Step next(Instances::iterator from);
  bool advance(const Step& step);
  bool stays_up(const Step& step);
  EarlyOutcome begin(UpdatedInstance& updated, OutcomeWatch& watch);
  void go_back(Instances::iterator end);
  EarlyOutcome begin_to_go_back(UpdatedInstance& updated, OutcomeWatch& watch);
  void confirm();
  bool abandoned() const { return desk_.leadership.closing().stop_requested() || !desk_.leadership.lead(); }
  void leave_out(Instances::iterator from, const std::string& why);
  OrderResult result() const;
  std::string name() const;
  static std::string former(const UpdatedInstance& updated);

  OrderDesk& desk_;
  InstancesUnderUpdate& under_update_;
  const UpdateRequest& request_;
  const PluginVersion wanted_;  ///< an empty file: each instance keeps its plugin
  std::map<InstanceId, const Texts*> properties_;
  std::vector<InstanceId> reserved_;
  Instances instances_;
  std::string failure_;  ///< what ended the update, and where
};

OrderResult RollingUpdate::run() {
  if (request_.plugin.empty() && request_.properties.empty())
    return refuse(OrderRefusal::bad_request, "an update gives a plugin, properties or both");
  if (!request_.plugin.empty()) {
    if (auto refusal = refuse_plugin(request_.plugin, request_.sha256)) return *refusal;
  }
  if (request_.at_once < 0 || request_.at_once > UpdateRequest::max_at_once)
    return refuse(OrderRefusal::bad_request, fmt::format("{} instances at once: must be from 1 to {}", request_.at_once,
                                                         UpdateRequest::max_at_once));
  if (auto refusal = prepare()) return *refusal;
  if (failure_.empty()) {
    for (auto from = instances_.begin(); from != instances_.end();) {
      const auto step = next(from);
      from = step.second;
      if (advance(step)) continue;
      leave_out(from, "not begun");
      if (!abandoned()) go_back(step.second);
      break;
    }
    if (failure_.empty()) confirm();
  }
  auto all = result();
  desk_.tell(all, "update");
  return all;
}

/// Checks that every instance can be updated, before anything is written.
std::optional<OrderResult> RollingUpdate::prepare() {
  const auto known = desk_.gateways();
  std::vector<LocatedInstance> instances;
  if (auto refusal = desk_.book.find_selected(request_.selection, known, instances)) return refusal;
  {
    const config::MutexLock lock(under_update_.mutex);
    for (const auto& where : instances) {
      if (under_update_.ids.insert(where.instance).second) {
        reserved_.push_back(where.instance);
        continue;
      }
      return refuse(OrderRefusal::bad_request,
                    fmt::format("an update of {} is under way already; wait for its end", where.instance));
    }
  }
  std::stable_sort(instances.begin(), instances.end(),
                   [](const auto& a, const auto& b) { return a.gateway < b.gateway; });
  for (auto& where : instances) {
    UpdatedInstance updated;
    updated.outcome = {where.gateway, where.instance, OrderOutcome::unknown, ""};
    updated.where = std::move(where);
    updated.wanted = wanted_;
    if (const auto found = properties_.find(updated.where.instance); found != properties_.end())
      updated.properties = found->second;
    instances_.push_back(std::move(updated));
  }
  for (auto& updated : instances_) {
    const std::string reason = obstacle(updated, known);
    if (reason.empty()) continue;
    updated.outcome.outcome = OrderOutcome::failed;
    updated.outcome.reason = reason;
    if (failure_.empty()) failure_ = fmt::format("{} on {}: {}", updated.where.instance, updated.where.gateway, reason);
  }
  if (!failure_.empty()) leave_out(instances_.begin(), "nothing was changed");
  return std::nullopt;
}

/// Why the instance cannot be updated; empty: it can.
std::string RollingUpdate::obstacle(UpdatedInstance& updated, const std::vector<GatewayStatus>& known) {
  const auto* gateway = find(known, updated.where.gateway);
  if (gateway == nullptr) return "its gateway is not registered any more";
  if (!gateway->alive) return "its gateway is lost, so nobody could see whether the update comes off";
  if (desk_.is_direct(updated.where.gateway)) return "its gateway is of the original system, which knows no updates";
  auto record = desk_.book.record_of(updated.where);
  if (!record) return "its gateway has not taken it up yet; try again in a moment";
  updated.record = std::move(*record);
  return "";
}

/// What the update brings, for people.
std::string RollingUpdate::name() const {
  if (wanted_.file.empty()) return "other properties";
  return request_.properties.empty() ? name_of(wanted_) : name_of(wanted_) + " with other properties";
}

/// What an instance that goes back has again.
std::string RollingUpdate::former(const UpdatedInstance& updated) {
  return updated.before == updated.wanted ? "its former properties" : name_of(updated.before);
}

/// The instances of the next step.
RollingUpdate::Step RollingUpdate::next(Instances::iterator from) {
  if (request_.at_once > 0) {
    const auto left = std::distance(from, instances_.end());
    return {from, from + std::min<std::ptrdiff_t>(left, request_.at_once)};
  }
  return {from, std::find_if(from, instances_.end(), [&](const UpdatedInstance& updated) {
            return updated.where.gateway != from->where.gateway;
          })};
}

/// Updates the instances of one step. \return whether all of them run the new version; else `failure_` says why not.
bool RollingUpdate::advance(const Step& step) {
  OutcomeWatch watch(desk_.registry, desk_.options.paths, OutcomeWatch::Wanted::updated);
  for (auto updated = step.first; updated != step.second; ++updated)
    OrderDesk::set_outcome(updated->outcome, begin(*updated, watch));
  const auto outcomes = watch.wait(desk_.limit(request_.selection.wait), desk_.leadership.closing());
  bool good = true;
  for (auto updated = step.first; updated != step.second; ++updated) {
    if (const auto found = outcomes.find(updated->where.instance); found != outcomes.end())
      OrderDesk::set_outcome(updated->outcome, found->second);
    if (updated->outcome.outcome == OrderOutcome::done) continue;
    good = false;
    if (failure_.empty())
      failure_ = fmt::format("{} on {}: {}", updated->where.instance, updated->where.gateway, updated->outcome.reason);
  }
  good = good && stays_up(step);
  logger.info("update to {}: {} on {} and so on: {}", name(), step.first->where.instance, step.first->where.gateway,
              good ? "done" : failure_);
  return good;
}

/// Waits for the settle time, because a driver that fails as soon as it is up has not come up.
/// \return whether all instances of the step stayed up; else `failure_` and the instance's outcome say which did not.
bool RollingUpdate::stays_up(const Step& step) {
  std::vector<Instances::iterator> watched;
  std::vector<std::string> paths;
  for (auto updated = step.first; updated != step.second; ++updated) {
    if (!updated->ordered) continue;
    watched.push_back(updated);
    paths.push_back(desk_.options.paths.instance(updated->where.driver, updated->where.instance));
  }
  std::map<InstanceId, std::int64_t> up_since;
  config::Mutex asleep;
  config::StoppableConditionVariable waking;  // only the end of this master wakes it
  const auto end = std::chrono::steady_clock::now() + std::min(request_.settle, longest_settle);
  while (std::chrono::steady_clock::now() < end && !desk_.leadership.closing().stop_requested()) {
    std::vector<std::optional<discovery::Node>> nodes(paths.size());
    try {
      nodes = desk_.registry.get_all(paths);
    } catch (const discovery::RegistryError& e) {
      logger.warn("cannot see whether an update stays up: {}", e.what());
    }
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      const auto record = discovery::driver_of(nodes[i], paths[i]);
      if (!record) continue;
      const auto since = up_since.emplace(record->instance, record->since_ms).first->second;
      const bool up = record->state == DriverState::inactive ||
                      (record->state == DriverState::active && (record->since_ms == since || record->reason.empty()));
      if (up) continue;
      auto& outcome = watched[i]->outcome;
      outcome.outcome = OrderOutcome::failed;
      outcome.reason = fmt::format("it came up and did not stay so: {}{}{}", to_string(record->state),
                                   record->reason.empty() ? "" : ", ", record->reason);
      failure_ = fmt::format("{} on {}: {}", outcome.instance, outcome.gateway, outcome.reason);
      return false;
    }
    const config::MutexLock lock(asleep);
    waking.wait_for(asleep, desk_.leadership.closing(), settle_pause, [] { return false; });
  }
  return true;
}

EarlyOutcome RollingUpdate::begin(UpdatedInstance& updated, OutcomeWatch& watch) {
  return desk_.leadership.written([&](const discovery::Lead& lead) -> EarlyOutcome {
    if (const auto order = desk_.book.get(updated.where.gateway, updated.where.instance)) {
      const auto state = order->active ? DriverState::active : DriverState::inactive;
      if (wanted_.file.empty()) updated.wanted = order->version();
      const bool same_properties = updated.properties == nullptr || *updated.properties == order->properties;
      if (order->version() == updated.wanted && same_properties && updated.record.state == state)
        return ReasonedOutcome{OrderOutcome::done, updated.properties == nullptr
                                                       ? "it runs this version already"
                                                       : "it has this version and properties already"};
    }
    const auto record =
        updated.properties == nullptr
            ? updated.where.record
            : desk_.registry.get(desk_.options.paths.instance(updated.where.driver, updated.where.instance));
    updated.ordered = true;  // set before the write, because its answer may be lost
    auto early = desk_.book.rewrite(updated.where, lead, [&](OrderRecord& order) {
      updated.before = order.version();
      updated.properties_before = order.properties;
      updated.active = order.active;
      // The driver's name is part of its topics, so it must stay when the plugin's file has another name.
      if (order.driver.empty()) order.driver = updated.where.driver;
      if (updated.properties != nullptr) order.properties = *updated.properties;
      if (wanted_.file.empty()) updated.wanted = order.version();
      if (order.version() == updated.wanted) return;
      order.previous = order.version();
      order.plugin = updated.wanted.file;
      order.sha256 = updated.wanted.sha256;
    });
    if (early) return early;
    const bool other_version = updated.before != updated.wanted;
    const bool same_name = updated.wanted.file == updated.record.plugin && other_version;
    watch.expect(updated.where.instance, updated.where.driver, record,
                 {updated.wanted.file, updated.wanted.sha256, same_name ? updated.record.sha256 : "", updated.active,
                  !other_version});
    return std::nullopt;
  });
}

/// Rolls back the instances from the first step on. \param end of the instances that may have been updated.
void RollingUpdate::go_back(Instances::iterator end) {
  logger.warn("the update to {} goes back: {}", name(), failure_);
  OutcomeWatch watch(desk_.registry, desk_.options.paths, OutcomeWatch::Wanted::updated);
  std::map<InstanceId, ReasonedOutcome> outcomes;
  for (auto updated = instances_.begin(); updated != end; ++updated) {
    if (!updated->ordered) continue;
    if (const auto early = begin_to_go_back(*updated, watch)) outcomes[updated->where.instance] = *early;
  }
  outcomes.merge(watch.wait(desk_.limit(request_.selection.wait), desk_.leadership.closing()));
  for (auto updated = instances_.begin(); updated != end; ++updated) {
    const auto found = outcomes.find(updated->where.instance);
    if (found == outcomes.end()) continue;
    auto& outcome = updated->outcome;
    const std::string why = outcome.outcome == OrderOutcome::done ? "the update failed, " + failure_ : outcome.reason;
    outcome.outcome = OrderOutcome::failed;
    outcome.reason = found->second.outcome == OrderOutcome::done
                         ? fmt::format("back on {}: {}", former(*updated), why)
                         : fmt::format("{}; going back to {}: {}: {}", why, former(*updated),
                                       to_string(found->second.outcome), found->second.reason);
  }
}

EarlyOutcome RollingUpdate::begin_to_go_back(UpdatedInstance& updated, OutcomeWatch& watch) {
  return desk_.leadership.written([&](const discovery::Lead& lead) -> EarlyOutcome {
    bool ours = false;
    // Without another plugin, only a state that is reached after the order shows that the instance is back.
    const auto now =
        updated.before == updated.wanted
            ? desk_.registry.get(desk_.options.paths.instance(updated.where.driver, updated.where.instance))
            : std::nullopt;
    auto early = desk_.book.rewrite(updated.where, lead, [&](OrderRecord& order) {
      const bool other_version = updated.before != updated.wanted;
      ours = order.version() == updated.wanted && order.previous.has_value() == other_version &&
             (updated.properties == nullptr || order.properties == *updated.properties);
      if (!ours) return;
      if (updated.properties != nullptr) order.properties = updated.properties_before;
      if (!other_version) return;
      updated.before = *order.previous;
      order.plugin = updated.before.file;
      order.sha256 = updated.before.sha256;
      order.previous.reset();
    });
    if (early) return early;
    if (!ours) return ReasonedOutcome{OrderOutcome::failed, "another order was given for it meanwhile, which stands"};
    const bool known = !updated.record.sha256.empty() && updated.record.plugin == updated.before.file;
    const bool other_version = updated.before != updated.wanted;
    const auto sha256 = known ? updated.record.sha256 : updated.before.sha256;
    watch.expect(
        updated.where.instance, updated.where.driver, now,
        {updated.before.file, sha256, other_version ? updated.wanted.sha256 : "", updated.active, !other_version});
    return std::nullopt;
  });
}

/// Ends a successful update: gateways need not keep the version before any more.
void RollingUpdate::confirm() {
  for (auto& updated : instances_) {
    if (!updated.ordered || updated.before == updated.wanted) continue;
    const auto problem = desk_.leadership.written([&](const discovery::Lead& lead) {
      return desk_.book.rewrite(updated.where, lead, [&](OrderRecord& order) {
        if (order.version() == updated.wanted) order.previous.reset();
      });
    });
    if (problem) logger.warn("{} keeps the version before the update too: {}", updated.where.instance, problem->reason);
  }
}

void RollingUpdate::leave_out(Instances::iterator from, const std::string& why) {
  for (auto updated = from; updated != instances_.end(); ++updated) {
    if (updated->outcome.outcome != OrderOutcome::unknown) continue;
    updated->outcome.outcome = OrderOutcome::failed;
    updated->outcome.reason = fmt::format("{}: {}", why, failure_);
  }
}

OrderResult RollingUpdate::result() const {
  OrderResult all;
  for (const auto& updated : instances_) all.outcomes.push_back(updated.outcome);
  return all;
}

}  // namespace

OrderResult Updates::update(const UpdateRequest& request) {
  return desk_.leadership.guarded([&] { return RollingUpdate(desk_, under_update_, request).run(); });
}

std::vector<OrderKind> update_orders() {
  return {order_kind<UpdateRequest>("update", security::Role::admin,
                                    [](auto& services, const auto& order) { return services.updates.update(order); })};
}

}  // namespace iotcloud::master
