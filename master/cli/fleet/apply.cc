#include <algorithm>
#include <atomic>
#include <map>
#include <set>
#include <span>
#include <thread>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/mutex.h>
#include <iotcloud/master/cli/fleet/apply.h>
#include <iotcloud/master/cli/master_client.h>
#include <iotcloud/master/cli/plugins/plugin_sending.h>

namespace iotcloud::master::cli {

namespace {

/// The most instances in one order: few enough that an order is short and that a person sees progress.
constexpr std::size_t most_orders_at_once = 200;
/// The most gateways whose steps are done at the same time, each with a connection to the master.
constexpr std::size_t most_connections = 8;
/// The wait limit of orders for a gateway that has not answered before.
constexpr std::chrono::milliseconds no_wait{1};

using Steps = std::span<const FleetStep>;
using Outcomes = std::span<FleetStepOutcome>;

/// Whether the step is a part of its deployment's rolling update.
bool rolls(const FleetStep& step) {
  return step.kind == FleetStepKind::update || (step.kind == FleetStepKind::change && !step.recorded_only);
}

bool needs_plugin(const FleetStep& step) {
  return step.kind == FleetStepKind::deploy || step.kind == FleetStepKind::replace ||
         step.kind == FleetStepKind::update;
}

/// Sends a deployment's plugin to gateways, before anything is ordered there. \return the gateways that did not take
/// it, with the reasons.
std::map<discovery::GatewayId, std::string> send(const ManifestDeployment& deployment,
                                                 const std::set<discovery::GatewayId>& gateways, MasterClient& master,
                                                 std::ostream* terminal) {
  std::map<discovery::GatewayId, std::string> not_sent;
  try {
    const auto sent = send_plugin(deployment.file, {gateways.begin(), gateways.end()}, master, terminal);
    if (sent.sha256 != deployment.sha256)
      throw RequestFailed(fmt::format("{} changed while the manifest was applied; apply it again", deployment.file));
    for (const auto& failure : sent.failures) not_sent[failure.gateway] = failure.reason;
  } catch (const std::exception& e) {  // Unreachable, RequestFailed, a file that is gone meanwhile
    for (const auto& gateway : gateways) not_sent[gateway] = e.what();
  }
  return not_sent;
}

/// Marks the steps of a deployment that come after its update as failed, because the update did not succeed.
/// \param gateway whose steps; empty: those of all gateways.
void leave_out(const FleetPlan& plan, std::size_t number, const discovery::GatewayId& gateway, const std::string& why,
               Outcomes outcomes) {
  for (std::size_t i = 0; i < plan.steps.size(); ++i) {
    const auto& step = plan.steps[i];
    if (step.kind > FleetStepKind::update && step.deployment == number && outcomes[i].outcome.empty() &&
        (gateway.empty() || step.gateway == gateway))
      outcomes[i] = {"failed", fmt::format("not begun, for its deployment was not updated: {}", why)};
  }
}

/// Sends the plugins that are files. Afterwards the steps whose gateways did not take the plugin have the outcome
/// `failed`.
void send_plugins(const Manifest& manifest, const FleetPlan& plan, const ApplyOptions& options, Outcomes outcomes) {
  std::map<std::size_t, std::set<discovery::GatewayId>> wanted;
  for (const auto& step : plan.steps) {
    if (needs_plugin(step) && !manifest.deployments.at(step.deployment).file.empty())
      wanted[step.deployment].insert(step.gateway);
  }
  if (wanted.empty()) return;
  const auto master = options.connect();
  for (const auto& [number, gateways] : wanted) {
    const auto not_sent = send(manifest.deployments.at(number), gateways, *master, options.terminal);
    for (const auto& [gateway, reason] : not_sent) {
      bool updates = false;
      for (std::size_t i = 0; i < plan.steps.size(); ++i) {
        const auto& step = plan.steps[i];
        if (step.deployment != number || step.gateway != gateway || !needs_plugin(step)) continue;
        outcomes[i] = {"failed", reason};
        updates = updates || step.kind == FleetStepKind::update;
      }
      if (updates) leave_out(plan, number, gateway, reason, outcomes);
    }
  }
}

/// Runs the rolling update of one deployment, of its plugin, its properties or both, for those of its instances whose
/// gateways have the plugin.
void roll(const Manifest& manifest, const FleetPlan& plan, std::size_t number, const ApplyOptions& options,
          Outcomes outcomes) {
  const auto& deployment = manifest.deployments.at(number);
  std::map<discovery::InstanceId, std::vector<std::size_t>> instances;  // their steps
  bool other_plugin = false;
  std::set<discovery::GatewayId> gateways;
  UpdateRequest request;
  for (std::size_t i = 0; i < plan.steps.size(); ++i) {
    const auto& step = plan.steps[i];
    if (!rolls(step) || step.deployment != number || !outcomes[i].outcome.empty()) continue;
    gateways.insert(step.gateway);
    auto& its = instances[step.instance];
    if (its.empty()) request.selection.instances.push_back(step.instance);
    its.push_back(i);
    other_plugin = other_plugin || step.kind == FleetStepKind::update;
    if (step.kind == FleetStepKind::change)
      request.properties.push_back({step.instance, deployment.properties_of(step.index)});
  }
  if (instances.empty()) return;
  request.selection.wait = options.wait;
  if (other_plugin) {
    request.plugin = deployment.plugin;
    request.sha256 = deployment.sha256;
  }
  request.settle = options.settle;
  FleetStepOutcome untold{"unknown", "the master did not say what became of it"};
  try {
    const auto answer = options.connect()->update(request, gateways.size());
    if (answer.refusal != OrderRefusal::none) untold = {"failed", answer.text};
    for (const auto& outcome : answer.outcomes) {
      const auto at = instances.find(outcome.instance);
      if (at == instances.end()) continue;
      for (const auto i : at->second) outcomes[i] = {to_string(outcome.outcome), outcome.reason};
    }
  } catch (const std::exception& e) {  // Unreachable, RequestFailed
    untold.reason = e.what();
  }
  std::string failure;
  for (const auto& [instance, its] : instances) {
    for (const auto i : its) {
      if (outcomes[i].outcome.empty()) outcomes[i] = untold;
      if (failure.empty() && outcomes[i].outcome != "done") failure = outcomes[i].reason;
    }
  }
  if (!failure.empty()) leave_out(plan, number, {}, failure, outcomes);
}

/// The steps of one gateway.
class GatewaySteps {
 public:
  GatewaySteps(const Manifest& manifest, Steps steps, Outcomes outcomes, const ApplyOptions& options)
      : manifest_(manifest), steps_(steps), outcomes_(outcomes), options_(options) {}

  /// Does the steps that come before rolling updates, or those that come after them. Skips steps that have an outcome
  /// already, as those of rolling updates have by then.
  /// \param did is called with the number of steps that were done.
  void run(MasterClient& master, bool after_updates, const std::function<void(std::size_t)>& did) {
    const auto bound = [&](auto reached) {
      return static_cast<std::size_t>(std::find_if(steps_.begin(), steps_.end(), reached) - steps_.begin());
    };
    const auto updates = bound([](const FleetStep& step) { return step.kind >= FleetStepKind::update; });
    const auto behind = bound([](const FleetStep& step) { return step.kind > FleetStepKind::update; });
    const auto stop = after_updates ? steps_.size() : updates;
    for (std::size_t begin = after_updates ? behind : 0; begin < stop;) {
      const bool open = outcomes_[begin].outcome.empty();
      std::size_t end = begin + 1;
      while (end < stop && end - begin < most_orders_at_once && alike(steps_[begin], steps_[end]) &&
             outcomes_[end].outcome.empty() == open)
        ++end;
      if (open) give(master, begin, end - begin);
      if (!rolls(steps_[begin])) did(end - begin);  // the rolling update has counted its steps
      begin = end;
    }
  }

 private:
  /// Whether one order can do both steps.
  static bool alike(const FleetStep& a, const FleetStep& b) {
    return a.kind == b.kind && a.deployment == b.deployment && a.name == b.name && a.metadata == b.metadata &&
           a.kind != FleetStepKind::change;  // each instance may have properties of its own
  }

  void give(MasterClient& master, std::size_t begin, std::size_t count) {
    const auto steps = steps_.subspan(begin, count);
    const auto outcomes = outcomes_.subspan(begin, count);
    try {
      if (steps.front().kind == FleetStepKind::replace) {
        replace(master, steps, outcomes);
      } else {
        note(order(master, steps), steps, outcomes);
      }
    } catch (const std::exception& e) {  // Unreachable, RequestFailed
      for (auto& outcome : outcomes) {
        if (outcome.outcome.empty()) outcome = {"unknown", e.what()};
      }
      silent_ = true;
    }
    for (const auto& outcome : outcomes) silent_ = silent_ || outcome.outcome == "unknown";
  }

  /// Undeploys instances, and deploys those again whose removal succeeded.
  void replace(MasterClient& master, Steps steps, Outcomes outcomes) {
    note(master.undeploy(selection(steps)), steps, outcomes);
    std::vector<FleetStep> gone;
    std::vector<std::size_t> places;
    for (std::size_t i = 0; i < steps.size(); ++i) {
      if (outcomes[i].outcome != "done") continue;
      gone.push_back(steps[i]);
      places.push_back(i);
    }
    if (gone.empty()) return;
    std::vector<FleetStepOutcome> deployed(gone.size());
    for (const auto place : places) outcomes[place] = {};  // empty outcomes, in case no master answers
    note(deploy(master, gone), gone, deployed);
    for (std::size_t i = 0; i < places.size(); ++i) outcomes[places[i]] = std::move(deployed[i]);
  }

  OrderResult order(MasterClient& master, Steps steps) const {
    const auto& deployment = manifest_.deployments;
    switch (steps.front().kind) {
      case FleetStepKind::undeploy:
      case FleetStepKind::replace:
        return master.undeploy(selection(steps));
      case FleetStepKind::stop:
        return master.stop(selection(steps));
      case FleetStepKind::start:
        return master.start(selection(steps));
      case FleetStepKind::describe:
        return master.update_metadata(selection(steps), steps.front().metadata);
      case FleetStepKind::adopt:
      case FleetStepKind::change: {
        DeploymentChange change;
        change.instances = ids(steps);
        change.wait = wait();
        if (steps.front().kind == FleetStepKind::adopt) {
          change.manager = manifest_.fleet;
        } else {
          change.properties = deployment.at(steps.front().deployment).properties_of(steps.front().index);
        }
        return master.change_deployment(change);
      }
      case FleetStepKind::update:  // roll() gives the updates of all gateways
      case FleetStepKind::deploy:
        break;
    }
    return deploy(master, steps);
  }

  OrderResult deploy(MasterClient& master, Steps steps) const {
    const auto& deployment = manifest_.deployments.at(steps.front().deployment);
    DeployRequest request;
    static_cast<discovery::Deployment&>(request) = static_cast<const discovery::Deployment&>(deployment);
    request.manager = manifest_.fleet;
    request.gateways = {steps.front().gateway};
    request.wait = wait();
    for (const auto& step : steps) {
      request.indexes.push_back(step.index);
      if (const auto own = deployment.own.find(step.index); own != deployment.own.end())
        request.own.push_back({step.index, own->second});
    }
    return master.deploy(request);
  }

  static std::vector<discovery::InstanceId> ids(Steps steps) {
    std::vector<discovery::InstanceId> out;
    for (const auto& step : steps) out.push_back(step.instance);
    return out;
  }
  InstanceSelection selection(Steps steps) const { return {ids(steps), {}, wait()}; }
  WaitLimit wait() const { return silent_ ? no_wait : options_.wait; }

  /// Copies the outcomes of an order to its steps. A master's outcomes are in the order of the request's instances;
  /// those of a deployment are in the order of their numbers, which is that of the steps.
  static void note(const OrderResult& answer, Steps steps, Outcomes outcomes) {
    const bool refused = answer.refusal != OrderRefusal::none || answer.outcomes.size() != steps.size();
    for (std::size_t i = 0; i < steps.size(); ++i) {
      outcomes[i] = refused ? FleetStepOutcome{"failed", answer.summary()}
                            : FleetStepOutcome{to_string(answer.outcomes[i].outcome), answer.outcomes[i].reason};
    }
  }

  const Manifest& manifest_;
  const Steps steps_;
  const Outcomes outcomes_;
  const ApplyOptions& options_;
  bool silent_ = false;  ///< the gateway did not answer an earlier order in time
};

/// Does the steps before the updates, or those after them, of all gateways in parallel.
void run_beside(std::vector<GatewaySteps>& gateways, bool after_updates, const ApplyOptions& options,
                const std::function<void(std::size_t)>& did) {
  std::atomic<std::size_t> next{0};
  std::vector<std::unique_ptr<MasterClient>> masters;
  for (std::size_t i = 0; i < std::min(most_connections, gateways.size()); ++i) masters.push_back(options.connect());
  std::vector<std::jthread> threads;
  threads.reserve(masters.size());
  for (auto& master : masters) {
    threads.emplace_back([&, &master = *master] {
      for (std::size_t at = next++; at < gateways.size(); at = next++) gateways[at].run(master, after_updates, did);
    });
  }
}

}  // namespace

std::vector<FleetStepOutcome> apply(const Manifest& manifest, const FleetPlan& plan, const ApplyOptions& options) {
  std::vector<FleetStepOutcome> outcomes(plan.steps.size());
  send_plugins(manifest, plan, options, outcomes);
  if (options.on_orders) options.on_orders();
  std::vector<GatewaySteps> gateways;
  std::map<std::size_t, std::size_t> updates;  // by deployment: the number of steps of its rolling update
  for (std::size_t begin = 0; begin < plan.steps.size();) {
    std::size_t end = begin;
    for (; end < plan.steps.size() && plan.steps[end].gateway == plan.steps[begin].gateway; ++end) {
      if (rolls(plan.steps[end])) ++updates[plan.steps[end].deployment];
    }
    gateways.emplace_back(manifest, Steps(plan.steps).subspan(begin, end - begin),
                          Outcomes(outcomes).subspan(begin, end - begin), options);
    begin = end;
  }
  config::Mutex mutex;
  std::size_t done = 0;  // changed with the mutex held, which the analysis does not see of a local variable
  const auto did = [&](std::size_t count) {
    const config::MutexLock lock(mutex);
    done += count;
    if (options.progress) options.progress(done, plan.steps.size());
  };
  run_beside(gateways, false, options, did);
  for (const auto& [number, count] : updates) {
    roll(manifest, plan, number, options, outcomes);
    did(count);
  }
  run_beside(gateways, true, options, did);
  return outcomes;
}

}  // namespace iotcloud::master::cli
