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
  struct Step {
    Located where;
    InstanceOutcome outcome;
    discovery::DriverRecord record;  ///< before the update
    PluginVersion before;
    Texts properties_before;
    PluginVersion wanted;
    const Texts* properties = nullptr;  ///< wanted; nullptr: they stay
    bool active = true;                 ///< the ordered state
    bool ordered = false;               ///< the change was written into its order, or may have been
  };
  using Steps = std::vector<Step>;
  using Range = std::pair<Steps::iterator, Steps::iterator>;

  std::optional<OrderResult> prepare();
  std::string obstacle(Step& step, const std::vector<GatewayStatus>& known);
  Range next(Steps::iterator from);
  bool advance(const Range& range);
  bool stays_up(const Range& range);
  MaybeVerdict begin(Step& step, OutcomeWatch& watch);
  void go_back(Steps::iterator end);
  MaybeVerdict begin_to_go_back(Step& step, OutcomeWatch& watch);
  void confirm();
  bool abandoned() const { return desk_.leadership.closing().stop_requested() || !desk_.leadership.lead(); }
  void leave_out(Steps::iterator from, const std::string& why);
  OrderResult result() const;
  std::string name() const;
  static std::string former(const Step& step);

  OrderDesk& desk_;
  InstancesUnderUpdate& under_update_;
  const UpdateRequest& request_;
  const PluginVersion wanted_;  ///< an empty file: each instance keeps its plugin
  std::map<InstanceId, const Texts*> properties_;
  std::vector<InstanceId> reserved_;
  Steps steps_;
  std::string failure_;  ///< what ended the update, and where
};

OrderResult RollingUpdate::run() {
  if (request_.plugin.empty() && request_.properties.empty())
    return refuse(Refusal::bad_request, "an update gives a plugin, properties or both");
  if (!request_.plugin.empty()) {
    if (auto refusal = refuse_plugin(request_.plugin, request_.sha256)) return *refusal;
  }
  if (request_.at_once < 0 || request_.at_once > UpdateRequest::max_at_once)
    return refuse(Refusal::bad_request, fmt::format("{} instances at once: must be from 1 to {}", request_.at_once,
                                                    UpdateRequest::max_at_once));
  if (auto refusal = prepare()) return *refusal;
  if (failure_.empty()) {
    for (auto from = steps_.begin(); from != steps_.end();) {
      const auto range = next(from);
      from = range.second;
      if (advance(range)) continue;
      leave_out(from, "not begun");
      if (!abandoned()) go_back(range.second);
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
  std::vector<Located> instances;
  if (auto refusal = desk_.book.find_selected(request_.selection, known, instances)) return refusal;
  {
    const config::MutexLock lock(under_update_.mutex);
    for (const auto& where : instances) {
      if (under_update_.ids.insert(where.instance).second) {
        reserved_.push_back(where.instance);
        continue;
      }
      return refuse(Refusal::bad_request,
                    fmt::format("an update of {} is under way already; wait for its end", where.instance));
    }
  }
  std::stable_sort(instances.begin(), instances.end(),
                   [](const auto& a, const auto& b) { return a.gateway < b.gateway; });
  for (auto& where : instances) {
    Step step;
    step.outcome = {where.gateway, where.instance, OrderOutcome::unknown, ""};
    step.where = std::move(where);
    step.wanted = wanted_;
    if (const auto found = properties_.find(step.where.instance); found != properties_.end())
      step.properties = found->second;
    steps_.push_back(std::move(step));
  }
  for (auto& step : steps_) {
    const std::string reason = obstacle(step, known);
    if (reason.empty()) continue;
    step.outcome.outcome = OrderOutcome::failed;
    step.outcome.reason = reason;
    if (failure_.empty()) failure_ = fmt::format("{} on {}: {}", step.where.instance, step.where.gateway, reason);
  }
  if (!failure_.empty()) leave_out(steps_.begin(), "nothing was changed");
  return std::nullopt;
}

/// Why the instance cannot be updated; empty: it can.
std::string RollingUpdate::obstacle(Step& step, const std::vector<GatewayStatus>& known) {
  const auto* gateway = find(known, step.where.gateway);
  if (gateway == nullptr) return "its gateway is not registered any more";
  if (!gateway->alive) return "its gateway is lost, so nobody could see whether the update comes off";
  if (desk_.is_direct(step.where.gateway)) return "its gateway is of the original system, which knows no updates";
  if (!step.where.record) return "its gateway has not taken it up yet; try again in a moment";
  step.record = discovery::decode_driver(step.where.record->data, step.where.instance);
  return "";
}

/// What the update brings, for people.
std::string RollingUpdate::name() const {
  if (wanted_.file.empty()) return "other properties";
  return request_.properties.empty() ? name_of(wanted_) : name_of(wanted_) + " with other properties";
}

/// What an instance that goes back has again.
std::string RollingUpdate::former(const Step& step) {
  return step.before == step.wanted ? "its former properties" : name_of(step.before);
}

/// The instances of the next step.
RollingUpdate::Range RollingUpdate::next(Steps::iterator from) {
  if (request_.at_once > 0) {
    const auto left = std::distance(from, steps_.end());
    return {from, from + std::min<std::ptrdiff_t>(left, request_.at_once)};
  }
  return {from, std::find_if(from, steps_.end(),
                             [&](const Step& step) { return step.where.gateway != from->where.gateway; })};
}

/// Updates the instances of one step. \return whether all of them run the new version; else `failure_` says why not.
bool RollingUpdate::advance(const Range& range) {
  OutcomeWatch watch(desk_.registry, desk_.options.paths, OutcomeWatch::Wanted::updated);
  for (auto step = range.first; step != range.second; ++step)
    OrderDesk::set_verdict(step->outcome, begin(*step, watch));
  const auto verdicts = watch.wait(desk_.limit(request_.selection.wait), desk_.leadership.closing());
  bool good = true;
  for (auto step = range.first; step != range.second; ++step) {
    if (const auto found = verdicts.find(step->where.instance); found != verdicts.end())
      OrderDesk::set_verdict(step->outcome, found->second);
    if (step->outcome.outcome == OrderOutcome::done) continue;
    good = false;
    if (failure_.empty())
      failure_ = fmt::format("{} on {}: {}", step->where.instance, step->where.gateway, step->outcome.reason);
  }
  good = good && stays_up(range);
  logger.info("update to {}: {} on {} and so on: {}", name(), range.first->where.instance, range.first->where.gateway,
              good ? "done" : failure_);
  return good;
}

/// Waits for the settle time, because a driver that fails as soon as it is up has not come up.
/// \return whether all instances of the range stayed up; else `failure_` and the instance's outcome say which did not.
bool RollingUpdate::stays_up(const Range& range) {
  std::vector<Steps::iterator> watched;
  std::vector<std::string> paths;
  for (auto step = range.first; step != range.second; ++step) {
    if (!step->ordered) continue;
    watched.push_back(step);
    paths.push_back(desk_.options.paths.instance(step->where.driver, step->where.instance));
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
      if (!nodes[i]) continue;
      const auto record = discovery::decode_driver(nodes[i]->data, paths[i]);
      const auto since = up_since.emplace(record.instance, record.since_ms).first->second;
      const bool up = record.state == DriverState::inactive ||
                      (record.state == DriverState::active && (record.since_ms == since || record.reason.empty()));
      if (up) continue;
      auto& outcome = watched[i]->outcome;
      outcome.outcome = OrderOutcome::failed;
      outcome.reason = fmt::format("it came up and did not stay so: {}{}{}", to_string(record.state),
                                   record.reason.empty() ? "" : ", ", record.reason);
      failure_ = fmt::format("{} on {}: {}", outcome.instance, outcome.gateway, outcome.reason);
      return false;
    }
    const config::MutexLock lock(asleep);
    waking.wait_for(asleep, desk_.leadership.closing(), settle_pause, [] { return false; });
  }
  return true;
}

MaybeVerdict RollingUpdate::begin(Step& step, OutcomeWatch& watch) {
  return desk_.leadership.written([&](const discovery::Lead& lead) -> MaybeVerdict {
    if (const auto order = desk_.book.get(step.where.gateway, step.where.instance)) {
      const auto state = order->active ? DriverState::active : DriverState::inactive;
      if (wanted_.file.empty()) step.wanted = order->version();
      const bool same_properties = step.properties == nullptr || *step.properties == order->properties;
      if (order->version() == step.wanted && same_properties && step.record.state == state)
        return Verdict{OrderOutcome::done, step.properties == nullptr ? "it runs this version already"
                                                                      : "it has this version and properties already"};
    }
    const auto record = step.properties == nullptr
                            ? step.where.record
                            : desk_.registry.get(desk_.options.paths.instance(step.where.driver, step.where.instance));
    step.ordered = true;  // set before the write, because its answer may be lost
    auto verdict = desk_.book.rewrite(step.where, lead, [&](OrderRecord& order) {
      step.before = order.version();
      step.properties_before = order.properties;
      step.active = order.active;
      // The driver's name is part of its topics, so it must stay when the plugin's file has another name.
      if (order.driver.empty()) order.driver = step.where.driver;
      if (step.properties != nullptr) order.properties = *step.properties;
      if (wanted_.file.empty()) step.wanted = order.version();
      if (order.version() == step.wanted) return;
      order.previous = order.version();
      order.plugin = step.wanted.file;
      order.sha256 = step.wanted.sha256;
    });
    if (verdict) return verdict;
    const bool other_version = step.before != step.wanted;
    const bool same_name = step.wanted.file == step.record.plugin && other_version;
    watch.expect(
        step.where.instance, step.where.driver, record,
        {step.wanted.file, step.wanted.sha256, same_name ? step.record.sha256 : "", step.active, !other_version});
    return std::nullopt;
  });
}

/// Rolls back the instances from the first step on. \param end of the instances that may have been updated.
void RollingUpdate::go_back(Steps::iterator end) {
  logger.warn("the update to {} goes back: {}", name(), failure_);
  OutcomeWatch watch(desk_.registry, desk_.options.paths, OutcomeWatch::Wanted::updated);
  std::map<InstanceId, Verdict> verdicts;
  for (auto step = steps_.begin(); step != end; ++step) {
    if (!step->ordered) continue;
    if (const auto verdict = begin_to_go_back(*step, watch)) verdicts[step->where.instance] = *verdict;
  }
  verdicts.merge(watch.wait(desk_.limit(request_.selection.wait), desk_.leadership.closing()));
  for (auto step = steps_.begin(); step != end; ++step) {
    const auto found = verdicts.find(step->where.instance);
    if (found == verdicts.end()) continue;
    auto& outcome = step->outcome;
    const std::string why = outcome.outcome == OrderOutcome::done ? "the update failed, " + failure_ : outcome.reason;
    outcome.outcome = OrderOutcome::failed;
    outcome.reason = found->second.outcome == OrderOutcome::done
                         ? fmt::format("back on {}: {}", former(*step), why)
                         : fmt::format("{}; going back to {}: {}: {}", why, former(*step),
                                       to_string(found->second.outcome), found->second.reason);
  }
}

MaybeVerdict RollingUpdate::begin_to_go_back(Step& step, OutcomeWatch& watch) {
  return desk_.leadership.written([&](const discovery::Lead& lead) -> MaybeVerdict {
    bool ours = false;
    // Without another plugin, only a state that is reached after the order shows that the instance is back.
    const auto now = step.before == step.wanted
                         ? desk_.registry.get(desk_.options.paths.instance(step.where.driver, step.where.instance))
                         : std::nullopt;
    auto verdict = desk_.book.rewrite(step.where, lead, [&](OrderRecord& order) {
      const bool other_version = step.before != step.wanted;
      ours = order.version() == step.wanted && order.previous.has_value() == other_version &&
             (step.properties == nullptr || order.properties == *step.properties);
      if (!ours) return;
      if (step.properties != nullptr) order.properties = step.properties_before;
      if (!other_version) return;
      step.before = *order.previous;
      order.plugin = step.before.file;
      order.sha256 = step.before.sha256;
      order.previous.reset();
    });
    if (verdict) return verdict;
    if (!ours) return Verdict{OrderOutcome::failed, "another order was given for it meanwhile, which stands"};
    const bool known = !step.record.sha256.empty() && step.record.plugin == step.before.file;
    const bool other_version = step.before != step.wanted;
    const auto sha256 = known ? step.record.sha256 : step.before.sha256;
    watch.expect(step.where.instance, step.where.driver, now,
                 {step.before.file, sha256, other_version ? step.wanted.sha256 : "", step.active, !other_version});
    return std::nullopt;
  });
}

/// Ends a successful update: gateways need not keep the version before any more.
void RollingUpdate::confirm() {
  for (auto& step : steps_) {
    if (!step.ordered || step.before == step.wanted) continue;
    const auto problem = desk_.leadership.written([&](const discovery::Lead& lead) {
      return desk_.book.rewrite(step.where, lead, [&](OrderRecord& order) {
        if (order.version() == step.wanted) order.previous.reset();
      });
    });
    if (problem) logger.warn("{} keeps the version before the update too: {}", step.where.instance, problem->reason);
  }
}

void RollingUpdate::leave_out(Steps::iterator from, const std::string& why) {
  for (auto step = from; step != steps_.end(); ++step) {
    if (step->outcome.outcome != OrderOutcome::unknown) continue;
    step->outcome.outcome = OrderOutcome::failed;
    step->outcome.reason = fmt::format("{}: {}", why, failure_);
  }
}

OrderResult RollingUpdate::result() const {
  OrderResult all;
  for (const auto& step : steps_) all.outcomes.push_back(step.outcome);
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
