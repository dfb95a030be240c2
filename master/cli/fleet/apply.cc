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

/// Why gateways did not take a deployment's plugin, by its number and gateway.
using NotSent = std::map<std::pair<std::size_t, std::string>, std::string>;

bool needs_plugin(const Step& step) {
  return step.kind == StepKind::deploy || step.kind == StepKind::replace;
}

/// Sends a deployment's plugin to gateways, before anything is ordered there.
void send(const Deployment& deployment, std::size_t number, const std::set<std::string>& gateways, MasterClient& master,
          std::ostream* terminal, NotSent& not_sent) {
  try {
    const auto sent = send_plugin(deployment.file, {gateways.begin(), gateways.end()}, master, terminal);
    if (sent.sha256 != deployment.sha256)
      throw Failed(fmt::format("{} changed while the manifest was applied; apply it again", deployment.file));
    for (const auto& failure : sent.failures) not_sent[{number, failure.gateway}] = failure.reason;
  } catch (const std::exception& e) {  // Unreachable, Failed, a file that is gone meanwhile
    for (const auto& gateway : gateways) not_sent[{number, gateway}] = e.what();
  }
}

NotSent send_plugins(const Manifest& manifest, const Plan& plan, const ApplyOptions& options) {
  std::map<std::size_t, std::set<std::string>> wanted;
  for (const auto& step : plan.steps) {
    if (needs_plugin(step) && !manifest.deployments.at(step.deployment).file.empty())
      wanted[step.deployment].insert(step.gateway);
  }
  NotSent not_sent;
  if (wanted.empty()) return not_sent;
  const auto master = options.connect();
  for (const auto& [number, gateways] : wanted)
    send(manifest.deployments.at(number), number, gateways, *master, options.terminal, not_sent);
  return not_sent;
}

/// The steps of one gateway.
class GatewaySteps {
 public:
  GatewaySteps(const Manifest& manifest, Steps steps, std::span<StepOutcome> outcomes, const NotSent& not_sent,
               const ApplyOptions& options)
      : manifest_(manifest), steps_(steps), outcomes_(outcomes), not_sent_(not_sent), options_(options) {}

  /// \param did tells how many steps were done.
  void run(MasterClient& master, const std::function<void(std::size_t)>& did) {
    for (std::size_t begin = 0; begin < steps_.size();) {
      std::size_t end = begin + 1;
      while (end < steps_.size() && end - begin < most_at_once && alike(steps_[begin], steps_[end])) ++end;
      give(master, begin, end - begin);
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
    const auto lacking = not_sent_.find({steps.front().deployment, steps.front().gateway});
    if (needs_plugin(steps.front()) && lacking != not_sent_.end()) {
      for (auto& outcome : outcomes) outcome = {"failed", lacking->second};
      return;
    }
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
  void replace(MasterClient& master, Steps steps, std::span<StepOutcome> outcomes) {
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
  static void note(const wire::TOrderResponse& answer, Steps steps, std::span<StepOutcome> outcomes) {
    const bool refused = answer.refusal != wire::TRefusal::NONE || answer.outcomes.size() != steps.size();
    for (std::size_t i = 0; i < steps.size(); ++i) {
      outcomes[i] = refused ? StepOutcome{"failed", answer.response.statusMessage}
                            : StepOutcome{word(answer.outcomes[i].outcome), answer.outcomes[i].reason};
    }
  }

  const Manifest& manifest_;
  const Steps steps_;
  const std::span<StepOutcome> outcomes_;
  const NotSent& not_sent_;
  const ApplyOptions& options_;
  bool silent_ = false;  ///< it did not answer in time
};

}  // namespace

std::vector<StepOutcome> apply(const Manifest& manifest, const Plan& plan, const ApplyOptions& options) {
  std::vector<StepOutcome> outcomes(plan.steps.size());
  const auto not_sent = send_plugins(manifest, plan, options);
  std::vector<GatewaySteps> gateways;
  for (std::size_t begin = 0; begin < plan.steps.size();) {
    std::size_t end = begin + 1;
    while (end < plan.steps.size() && plan.steps[end].gateway == plan.steps[begin].gateway) ++end;
    gateways.emplace_back(manifest, Steps(plan.steps).subspan(begin, end - begin),
                          std::span(outcomes).subspan(begin, end - begin), not_sent, options);
    begin = end;
  }
  std::atomic<std::size_t> next{0};
  std::mutex mutex;
  std::size_t done = 0;  // guarded by mutex
  const auto did = [&](std::size_t count) {
    const std::lock_guard lock(mutex);
    done += count;
    if (options.progress) options.progress(done, plan.steps.size());
  };
  std::vector<std::unique_ptr<MasterClient>> masters;
  for (std::size_t i = 0; i < std::min(most_connections, gateways.size()); ++i) masters.push_back(options.connect());
  {
    std::vector<std::jthread> threads;
    threads.reserve(masters.size());
    for (auto& master : masters) {
      threads.emplace_back([&next, &gateways, &did, &master = *master] {
        for (std::size_t at = next++; at < gateways.size(); at = next++) gateways[at].run(master, did);
      });
    }
  }
  return outcomes;
}

}  // namespace iotcloud::master::cli
