#include <algorithm>
#include <atomic>
#include <map>
#include <mutex>
#include <set>
#include <span>
#include <thread>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/master/cli/fleet/apply.h>
#include <iotcloud/master/cli/master_client.h>
#include <iotcloud/master/cli/plugins/plugin_sending.h>
#include <iotcloud/master/cli/topology/topology_command.h>

namespace iotcloud::master::cli {

namespace {

/// Instances in one order: few enough that an order is short and its progress is seen.
constexpr std::size_t most_at_once = 200;
/// Gateways that are spoken with at the same time.
constexpr std::size_t most_connections = 8;
/// For a gateway that is known not to answer.
constexpr std::int64_t no_wait_ms = 1;

using Steps = std::span<const Step>;
using Outcomes = std::span<StepOutcome>;

bool needs_plugin(const Step& step) {
  return step.kind == StepKind::deploy || step.kind == StepKind::replace || step.kind == StepKind::update;
}

/// Sends a deployment's plugin to gateways, before anything is ordered there. \return why gateways did not take it.
std::map<std::string, std::string> send(const Deployment& deployment, const std::set<std::string>& gateways,
                                        MasterClient& master, std::ostream* terminal) {
  std::map<std::string, std::string> not_sent;
  try {
    const auto sent = send_plugin(deployment.file, {gateways.begin(), gateways.end()}, master, terminal);
    if (sent.sha256 != deployment.sha256)
      throw Failed(fmt::format("{} changed while the manifest was applied; apply it again", deployment.file));
    for (const auto& failure : sent.failures) not_sent[failure.gateway] = failure.reason;
  } catch (const std::exception& e) {  // Unreachable, Failed, a file that is gone meanwhile
    for (const auto& gateway : gateways) not_sent[gateway] = e.what();
  }
  return not_sent;
}

/// What becomes of a deployment's later steps when it does not come to its plugin. \param gateway empty: on all.
void leave_out(const Plan& plan, std::size_t number, const std::string& gateway, const std::string& why,
               Outcomes outcomes) {
  for (std::size_t i = 0; i < plan.steps.size(); ++i) {
    const auto& step = plan.steps[i];
    if (step.kind > StepKind::update && step.deployment == number && (gateway.empty() || step.gateway == gateway))
      outcomes[i] = {"failed", fmt::format("not begun, for its deployment was not updated: {}", why)};
  }
}

/// Sends what is to be sent. Steps that cannot be done for want of a plugin have their outcomes then.
void send_plugins(const Manifest& manifest, const Plan& plan, const ApplyOptions& options, Outcomes outcomes) {
  std::map<std::size_t, std::set<std::string>> wanted;
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
        updates = updates || step.kind == StepKind::update;
      }
      if (updates) leave_out(plan, number, gateway, reason, outcomes);
    }
  }
}

/// A rolling update of one deployment: of those of its instances whose gateways have the plugin.
void roll(const Manifest& manifest, const Plan& plan, std::size_t number, const ApplyOptions& options,
          Outcomes outcomes) {
  const auto& deployment = manifest.deployments.at(number);
  std::map<std::string, std::size_t> instances;  // their steps
  std::set<std::string> gateways;
  wire::TUpdateRequest request;
  for (std::size_t i = 0; i < plan.steps.size(); ++i) {
    const auto& step = plan.steps[i];
    if (step.kind != StepKind::update || step.deployment != number || !outcomes[i].outcome.empty()) continue;
    instances[step.instance] = i;
    gateways.insert(step.gateway);
    request.selection.instances.push_back(step.instance);
  }
  if (instances.empty()) return;
  request.selection.__set_waitMs(options.wait_ms);
  request.__set_plugin(deployment.plugin);
  request.__set_sha256(deployment.sha256);
  request.__set_settleMs(options.settle_ms);
  StepOutcome untold{"unknown", "the master did not say what became of it"};
  try {
    const auto answer = options.connect()->update(request, gateways.size());
    if (answer.refusal != wire::TRefusal::NONE) untold = {"failed", answer.response.statusMessage};
    for (const auto& outcome : answer.outcomes) {
      const auto at = instances.find(outcome.instance);
      if (at != instances.end()) outcomes[at->second] = {word(outcome.outcome), outcome.reason};
    }
  } catch (const std::exception& e) {  // Unreachable, Failed
    untold.reason = e.what();
  }
  std::string failure;
  for (const auto& [instance, i] : instances) {
    if (outcomes[i].outcome.empty()) outcomes[i] = untold;
    if (failure.empty() && outcomes[i].outcome != "done") failure = outcomes[i].reason;
  }
  if (!failure.empty()) leave_out(plan, number, "", failure, outcomes);
}

/// The steps of one gateway.
class GatewaySteps {
 public:
  GatewaySteps(const Manifest& manifest, Steps steps, Outcomes outcomes, const ApplyOptions& options)
      : manifest_(manifest), steps_(steps), outcomes_(outcomes), options_(options) {}

  /// Those that go before updates, or those that come after them. One whose outcome is known is passed by.
  /// \param did tells how many steps were done.
  void run(MasterClient& master, bool after_updates, const std::function<void(std::size_t)>& did) {
    const auto bound = [&](auto reached) {
      return static_cast<std::size_t>(std::find_if(steps_.begin(), steps_.end(), reached) - steps_.begin());
    };
    const auto updates = bound([](const Step& step) { return step.kind >= StepKind::update; });
    const auto behind = bound([](const Step& step) { return step.kind > StepKind::update; });
    const auto stop = after_updates ? steps_.size() : updates;
    for (std::size_t begin = after_updates ? behind : 0; begin < stop;) {
      const bool open = outcomes_[begin].outcome.empty();
      std::size_t end = begin + 1;
      while (end < stop && end - begin < most_at_once && alike(steps_[begin], steps_[end]) &&
             outcomes_[end].outcome.empty() == open)
        ++end;
      if (open) give(master, begin, end - begin);
      did(end - begin);
      begin = end;
    }
  }

 private:
  /// Whether both can be said with one order.
  static bool alike(const Step& a, const Step& b) {
    return a.kind == b.kind && a.deployment == b.deployment && a.name == b.name && a.metadata == b.metadata;
  }

  void give(MasterClient& master, std::size_t begin, std::size_t count) {
    const auto steps = steps_.subspan(begin, count);
    const auto outcomes = outcomes_.subspan(begin, count);
    try {
      if (steps.front().kind == StepKind::replace) {
        replace(master, steps, outcomes);
      } else {
        note(order(master, steps), steps, outcomes);
      }
    } catch (const std::exception& e) {  // Unreachable, Failed
      for (auto& outcome : outcomes) {
        if (outcome.outcome.empty()) outcome = {"unknown", e.what()};
      }
      silent_ = true;
    }
    for (const auto& outcome : outcomes) silent_ = silent_ || outcome.outcome == "unknown";
  }

  /// Only what is gone is deployed again.
  void replace(MasterClient& master, Steps steps, Outcomes outcomes) {
    note(master.undeploy(selection(steps)), steps, outcomes);
    std::vector<Step> gone;
    std::vector<std::size_t> places;
    for (std::size_t i = 0; i < steps.size(); ++i) {
      if (outcomes[i].outcome != "done") continue;
      gone.push_back(steps[i]);
      places.push_back(i);
    }
    if (gone.empty()) return;
    std::vector<StepOutcome> deployed(gone.size());
    for (const auto place : places) outcomes[place] = {};  // should no master answer
    note(deploy(master, gone), gone, deployed);
    for (std::size_t i = 0; i < places.size(); ++i) outcomes[places[i]] = std::move(deployed[i]);
  }

  wire::TOrderResponse order(MasterClient& master, Steps steps) const {
    const auto& deployment = manifest_.deployments;
    switch (steps.front().kind) {
      case StepKind::undeploy:
      case StepKind::replace:
        return master.undeploy(selection(steps));
      case StepKind::stop:
        return master.stop(selection(steps));
      case StepKind::start:
        return master.start(selection(steps));
      case StepKind::describe:
        return master.update_metadata(selection(steps), steps.front().metadata);
      case StepKind::adopt:
      case StepKind::change: {
        wire::TDeploymentChange change;
        change.__set_instances(ids(steps));
        change.__set_waitMs(wait());
        if (steps.front().kind == StepKind::adopt) {
          change.__set_manager(manifest_.fleet);
        } else {
          change.__set_properties(deployment.at(steps.front().deployment).properties);
        }
        return master.change_deployment(change);
      }
      case StepKind::update:  // roll() gives those of all gateways
      case StepKind::deploy:
        break;
    }
    return deploy(master, steps);
  }

  wire::TOrderResponse deploy(MasterClient& master, Steps steps) const {
    const auto& deployment = manifest_.deployments.at(steps.front().deployment);
    wire::TDeployRequest request;
    request.__set_gateways({steps.front().gateway});
    request.__set_plugin(deployment.plugin);
    request.__set_sha256(deployment.sha256);
    request.__set_driver(deployment.driver);
    request.__set_properties(deployment.properties);
    request.__set_metadata(deployment.metadata);
    request.__set_waitMs(wait());
    request.__set_name(deployment.name);
    request.__set_manager(manifest_.fleet);
    request.__set_active(deployment.active);
    for (const auto& step : steps) request.indexes.push_back(step.index);
    return master.deploy(request);
  }

  static std::vector<std::string> ids(Steps steps) {
    std::vector<std::string> out;
    for (const auto& step : steps) out.push_back(step.instance);
    return out;
  }
  wire::TInstanceSelection selection(Steps steps) const {
    wire::TInstanceSelection selection;
    selection.__set_instances(ids(steps));
    selection.__set_waitMs(wait());
    return selection;
  }
  std::int64_t wait() const { return silent_ ? no_wait_ms : options_.wait_ms; }

  /// A master answers in the order in which it was asked; deployments in the order of their numbers, which the steps
  /// have.
  static void note(const wire::TOrderResponse& answer, Steps steps, Outcomes outcomes) {
    const bool refused = answer.refusal != wire::TRefusal::NONE || answer.outcomes.size() != steps.size();
    for (std::size_t i = 0; i < steps.size(); ++i) {
      outcomes[i] = refused ? StepOutcome{"failed", answer.response.statusMessage}
                            : StepOutcome{word(answer.outcomes[i].outcome), answer.outcomes[i].reason};
    }
  }

  const Manifest& manifest_;
  const Steps steps_;
  const Outcomes outcomes_;
  const ApplyOptions& options_;
  bool silent_ = false;  ///< it did not answer in time
};

/// Does the steps before the updates, or those after them, of all gateways beside each other.
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

std::vector<StepOutcome> apply(const Manifest& manifest, const Plan& plan, const ApplyOptions& options) {
  std::vector<StepOutcome> outcomes(plan.steps.size());
  send_plugins(manifest, plan, options, outcomes);
  std::vector<GatewaySteps> gateways;
  std::map<std::size_t, std::size_t> updates;  // how many steps, by deployment
  for (std::size_t begin = 0; begin < plan.steps.size();) {
    std::size_t end = begin;
    for (; end < plan.steps.size() && plan.steps[end].gateway == plan.steps[begin].gateway; ++end) {
      if (plan.steps[end].kind == StepKind::update) ++updates[plan.steps[end].deployment];
    }
    gateways.emplace_back(manifest, Steps(plan.steps).subspan(begin, end - begin),
                          Outcomes(outcomes).subspan(begin, end - begin), options);
    begin = end;
  }
  std::mutex mutex;
  std::size_t done = 0;  // guarded by mutex
  const auto did = [&](std::size_t count) {
    const std::lock_guard lock(mutex);
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
