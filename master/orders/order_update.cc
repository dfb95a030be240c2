// A rolling update: step by step, and back again when a step does not come off.
#include <algorithm>
#include <chrono>
#include <map>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/config/signing/sha256.h>
#include <iotcloud/master/orders/master_impl.h>

namespace iotcloud::master {

using discovery::DriverState;
using discovery::GatewayStatus;
using discovery::OrderRecord;
using discovery::PluginVersion;
using Verdict = OutcomeWatch::Verdict;

namespace {

constexpr config::Logger logger{"master"};
constexpr std::chrono::milliseconds settle_pause{200};
constexpr std::chrono::milliseconds longest_settle{600'000};

std::string name_of(const PluginVersion& version) {
  return version.sha256.empty() ? version.file
                                : fmt::format("{} ({})", version.file, config::short_sha256(version.sha256));
}

}  // namespace

/// One update, used by one thread.
class Master::Impl::RollingUpdate {
 public:
  RollingUpdate(Impl& master, const UpdateRequest& request)
      : master_(master), request_(request), wanted_{request.plugin, request.sha256} {}
  ~RollingUpdate() {
    const std::lock_guard lock(master_.mutex);
    for (const auto& instance : reserved_) master_.updating.erase(instance);
  }
  RollingUpdate(const RollingUpdate&) = delete;
  RollingUpdate& operator=(const RollingUpdate&) = delete;

  OrderResult run();

 private:
  struct Step {
    Located where;
    InstanceOutcome outcome;
    discovery::DriverRecord record;  ///< before the update
    PluginVersion before;
    bool active = true;    ///< as ordered
    bool ordered = false;  ///< its order may name the new version
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
  bool abandoned() const { return master_.closing.stop_requested() || !master_.election.leading(); }
  void leave_out(Steps::iterator from, const std::string& why);
  OrderResult result() const;

  Impl& master_;
  const UpdateRequest& request_;
  const PluginVersion wanted_;
  std::vector<std::string> reserved_;
  Steps steps_;
  std::string failure_;  ///< what ended the update, and where
};

OrderResult Master::update(const UpdateRequest& request) {
  return impl_->guarded([&] { return Impl::RollingUpdate(*impl_, request).run(); });
}

OrderResult Master::Impl::RollingUpdate::run() {
  if (auto refusal = refuse_plugin(request_.plugin, request_.sha256)) return *refusal;
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
  master_.tell(all, "update");
  return all;
}

/// Nothing is written before it is known that every instance can be updated.
std::optional<OrderResult> Master::Impl::RollingUpdate::prepare() {
  const auto known = discovery::list_gateways(master_.registry, master_.options.paths);
  std::vector<Located> instances;
  if (auto refusal = master_.find_selected(request_.selection, known, instances)) return refusal;
  {
    const std::lock_guard lock(master_.mutex);
    for (const auto& where : instances) {
      if (master_.updating.insert(where.instance).second) {
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
    step.outcome = {where.gateway, where.instance, Outcome::unknown, ""};
    step.where = std::move(where);
    steps_.push_back(std::move(step));
  }
  for (auto& step : steps_) {
    const std::string reason = obstacle(step, known);
    if (reason.empty()) continue;
    step.outcome.outcome = Outcome::failed;
    step.outcome.reason = reason;
    if (failure_.empty()) failure_ = fmt::format("{} on {}: {}", step.where.instance, step.where.gateway, reason);
  }
  if (!failure_.empty()) leave_out(steps_.begin(), "nothing was changed");
  return std::nullopt;
}

/// Why the instance cannot be updated; empty: it can.
std::string Master::Impl::RollingUpdate::obstacle(Step& step, const std::vector<GatewayStatus>& known) {
  const auto* gateway = find(known, step.where.gateway);
  if (gateway == nullptr) return "its gateway is not registered any more";
  if (!gateway->alive) return "its gateway is lost, so nobody could see whether the update comes off";
  if (master_.is_direct(step.where.gateway)) return "its gateway is of the original system, which knows no updates";
  if (!step.where.record) return "its gateway has not taken it up yet; try again in a moment";
  step.record = discovery::decode_driver(step.where.record->data, step.where.instance);
  return "";
}

/// Those of the next step.
Master::Impl::RollingUpdate::Range Master::Impl::RollingUpdate::next(Steps::iterator from) {
  if (request_.at_once > 0) {
    const auto left = std::distance(from, steps_.end());
    return {from, from + std::min<std::ptrdiff_t>(left, request_.at_once)};
  }
  return {from, std::find_if(from, steps_.end(),
                             [&](const Step& step) { return step.where.gateway != from->where.gateway; })};
}

/// \return whether all of the range run the new version; else `failure_` says why not.
bool Master::Impl::RollingUpdate::advance(const Range& range) {
  OutcomeWatch watch(master_.registry, master_.options.paths, OutcomeWatch::Wanted::updated);
  for (auto step = range.first; step != range.second; ++step) set_verdict(step->outcome, begin(*step, watch));
  const auto verdicts = watch.wait(master_.limit(request_.selection.wait), master_.closing.get_token());
  bool good = true;
  for (auto step = range.first; step != range.second; ++step) {
    if (const auto found = verdicts.find(step->where.instance); found != verdicts.end())
      set_verdict(step->outcome, found->second);
    if (step->outcome.outcome == Outcome::done) continue;
    good = false;
    if (failure_.empty())
      failure_ = fmt::format("{} on {}: {}", step->where.instance, step->where.gateway, step->outcome.reason);
  }
  good = good && stays_up(range);
  logger.info("update to {}: {} on {} and so on: {}", name_of(wanted_), range.first->where.instance,
              range.first->where.gateway, good ? "done" : failure_);
  return good;
}

/// A driver that falls over as soon as it is up has not come up.
/// \return whether none of the range did; else `failure_` and its outcome say which.
bool Master::Impl::RollingUpdate::stays_up(const Range& range) {
  std::vector<Steps::iterator> watched;
  std::vector<std::string> paths;
  for (auto step = range.first; step != range.second; ++step) {
    if (!step->ordered) continue;
    watched.push_back(step);
    paths.push_back(master_.options.paths.instance(step->where.driver, step->where.instance));
  }
  std::map<std::string, std::int64_t> up_since;
  std::mutex asleep;
  std::unique_lock lock(asleep);
  std::condition_variable_any waking;  // by the end of this master only
  const auto end = std::chrono::steady_clock::now() + std::min(request_.settle, longest_settle);
  while (std::chrono::steady_clock::now() < end && !master_.closing.stop_requested()) {
    std::vector<std::optional<discovery::Node>> nodes(paths.size());
    try {
      nodes = master_.registry.get_all(paths);
    } catch (const discovery::RegistryError& e) {
      logger.warn("whether an update stays up is not seen: {}", e.what());
    }
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      if (!nodes[i]) continue;
      const auto record = discovery::decode_driver(nodes[i]->data, paths[i]);
      const auto since = up_since.emplace(record.instance, record.since_ms).first->second;
      const bool up = record.state == DriverState::inactive ||
                      (record.state == DriverState::active && (record.since_ms == since || record.reason.empty()));
      if (up) continue;
      auto& outcome = watched[i]->outcome;
      outcome.outcome = Outcome::failed;
      outcome.reason = fmt::format("it came up and did not stay so: {}{}{}", to_string(record.state),
                                   record.reason.empty() ? "" : ", ", record.reason);
      failure_ = fmt::format("{} on {}: {}", outcome.instance, outcome.gateway, outcome.reason);
      return false;
    }
    waking.wait_for(lock, master_.closing.get_token(), settle_pause, [] { return false; });
  }
  return true;
}

Master::Impl::MaybeVerdict Master::Impl::RollingUpdate::begin(Step& step, OutcomeWatch& watch) {
  return master_.written([&](const discovery::Lead& lead) -> MaybeVerdict {
    const auto path = master_.options.paths.order(step.where.gateway, step.where.instance);
    if (const auto node = master_.registry.get(path)) {
      const auto order = discovery::decode_order(node->data, path);
      const auto state = order.active ? DriverState::active : DriverState::inactive;
      if (order.version() == wanted_ && step.record.state == state)
        return Verdict{Outcome::done, "it runs this version already"};
    }
    step.ordered = true;  // even when no answer comes
    auto verdict = master_.rewrite_order(step.where, lead, [&](OrderRecord& order) {
      step.before = order.version();
      step.active = order.active;
      // Its name is part of its topics: a file with another name must not change it.
      if (order.driver.empty()) order.driver = step.where.driver;
      order.previous = order.version();
      order.plugin = wanted_.file;
      order.sha256 = wanted_.sha256;
    });
    if (verdict) return verdict;
    const bool same_name = wanted_.file == step.record.plugin && step.before != wanted_;
    watch.expect(step.where.instance, step.where.driver, step.where.record,
                 {wanted_.file, wanted_.sha256, same_name ? step.record.sha256 : "", step.active});
    return std::nullopt;
  });
}

/// \param end of those that may have been updated.
void Master::Impl::RollingUpdate::go_back(Steps::iterator end) {
  logger.warn("the update to {} goes back: {}", name_of(wanted_), failure_);
  OutcomeWatch watch(master_.registry, master_.options.paths, OutcomeWatch::Wanted::updated);
  std::map<std::string, Verdict> verdicts;
  for (auto step = steps_.begin(); step != end; ++step) {
    if (!step->ordered) continue;
    if (const auto verdict = begin_to_go_back(*step, watch)) verdicts[step->where.instance] = *verdict;
  }
  verdicts.merge(watch.wait(master_.limit(request_.selection.wait), master_.closing.get_token()));
  for (auto step = steps_.begin(); step != end; ++step) {
    const auto found = verdicts.find(step->where.instance);
    if (found == verdicts.end()) continue;
    auto& outcome = step->outcome;
    const std::string why = outcome.outcome == Outcome::done ? "the update failed, " + failure_ : outcome.reason;
    outcome.outcome = Outcome::failed;
    outcome.reason = found->second.outcome == Outcome::done
                         ? fmt::format("back on {}: {}", name_of(step->before), why)
                         : fmt::format("{}; going back to {}: {}: {}", why, name_of(step->before),
                                       to_string(found->second.outcome), found->second.reason);
  }
}

Master::Impl::MaybeVerdict Master::Impl::RollingUpdate::begin_to_go_back(Step& step, OutcomeWatch& watch) {
  return master_.written([&](const discovery::Lead& lead) -> MaybeVerdict {
    bool ours = false;
    auto verdict = master_.rewrite_order(step.where, lead, [&](OrderRecord& order) {
      ours = order.version() == wanted_ && order.previous;
      if (!ours) return;
      step.before = *order.previous;
      order.plugin = step.before.file;
      order.sha256 = step.before.sha256;
      order.previous.reset();
    });
    if (verdict) return verdict;
    if (!ours) return Verdict{Outcome::failed, "another order was given for it meanwhile, which stands"};
    const bool known = !step.record.sha256.empty() && step.record.plugin == step.before.file;
    watch.expect(step.where.instance, step.where.driver, std::nullopt,
                 {step.before.file, known ? step.record.sha256 : step.before.sha256, wanted_.sha256, step.active});
    return std::nullopt;
  });
}

/// The update is over: gateways need not keep the version before any more.
void Master::Impl::RollingUpdate::confirm() {
  for (auto& step : steps_) {
    if (!step.ordered) continue;
    const auto problem = master_.written([&](const discovery::Lead& lead) {
      return master_.rewrite_order(step.where, lead, [&](OrderRecord& order) {
        if (order.version() == wanted_) order.previous.reset();
      });
    });
    if (problem) logger.warn("{} keeps the version before the update too: {}", step.where.instance, problem->reason);
  }
}

void Master::Impl::RollingUpdate::leave_out(Steps::iterator from, const std::string& why) {
  for (auto step = from; step != steps_.end(); ++step) {
    if (step->outcome.outcome != Outcome::unknown) continue;
    step->outcome.outcome = Outcome::failed;
    step->outcome.reason = fmt::format("{}: {}", why, failure_);
  }
}

OrderResult Master::Impl::RollingUpdate::result() const {
  OrderResult all;
  for (const auto& step : steps_) all.outcomes.push_back(step.outcome);
  return all;
}

}  // namespace iotcloud::master
