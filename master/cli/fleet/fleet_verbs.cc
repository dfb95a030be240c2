// diff, apply
#include <chrono>
#include <map>
#include <optional>
#include <ostream>
#include <set>
#include <utility>

#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/fleet/apply.h>
#include <iotcloud/master/cli/fleet/apply_topologies.h>
#include <iotcloud/master/cli/fleet/manifest.h>
#include <iotcloud/master/cli/fleet/plan.h>
#include <iotcloud/master/cli/fleet/plugin_declarations.h>
#include <iotcloud/master/cli/fleet/property_check.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/master/cli/waiting.h>

namespace iotcloud::master::cli {

namespace {

using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

Fleet read_fleet(MasterClient& master) {
  Fleet fleet;
  for (const auto& gateway : master.gateways())
    fleet.gateways.push_back({gateway.record.id, gateway.draining, gateway.original, !gateway.alive});
  std::map<discovery::InstanceId, std::string> failures;
  std::set<discovery::InstanceId> ordered;
  for (const auto& driver : master.drivers()) {
    if (driver.state == discovery::DriverState::ordered) ordered.insert(driver.instance);
    if (driver.state == discovery::DriverState::failed)
      failures[driver.instance] = driver.reason.empty() ? "the gateway gave no reason" : driver.reason;
  }
  for (auto& listed : master.orders()) {
    Fleet::Instance instance;
    static_cast<discovery::Deployment&>(instance) = static_cast<discovery::Deployment&>(listed.order);
    instance.gateway = listed.gateway;
    instance.instance = listed.order.instance;
    instance.index = listed.order.index;
    instance.failure = failures[listed.order.instance];
    instance.ordered = ordered.contains(listed.order.instance);
    instance.hidden = std::move(listed.hidden);
    fleet.instances.push_back(std::move(instance));
  }
  return fleet;
}

std::string full_name(const FleetStep& step) {
  return fmt::format("{}/{}", step.name, step.index);
}

std::string instances(std::size_t count) {
  return fmt::format("{} instance{}", count, count == 1 ? "" : "s");
}

Json to_json(const FleetStep& step) {
  return {{"change", to_string(step.kind)}, {"gateway", step.gateway}, {"name", step.name}, {"index", step.index},
          {"instance", step.instance},      {"what", step.what}};
}

Json rest_of(const FleetPlan& plan) {
  Json problems = Json::array();
  for (const auto& problem : plan.problems)
    problems.push_back({{"gateway", problem.gateway}, {"name", problem.name}, {"text", problem.text}});
  Json kept = Json::array();
  for (const auto& step : plan.kept)
    kept.push_back(
        {{"gateway", step.gateway}, {"name", step.name}, {"index", step.index}, {"instance", step.instance}});
  return {{"problems", problems},        {"kept", kept},
          {"passed_by", plan.passed_by}, {"same", plan.same},
          {"ordered", plan.ordered},     {"not_compared", plan.not_compared}};
}

/// Prints what else a plan says besides its steps: what is kept, skipped, not compared or impossible.
void tell_rest(const FleetPlan& plan, std::ostream& out, std::ostream& err) {
  if (!plan.kept.empty())
    out << fmt::format("kept, though the manifest does not name them any more: {}\n", instances(plan.kept.size()));
  if (plan.ordered > 0)
    out << fmt::format("only ordered: {} of lost gateways, which follow when they come back\n",
                       instances(plan.ordered));
  for (const auto& gateway : plan.passed_by) out << fmt::format("passed by: {} is draining\n", printable(gateway));
  if (!plan.not_compared.empty())
    out << fmt::format("not compared, for only an admin may see them: {}\n",
                       printable(fmt::format("{}", fmt::join(plan.not_compared, ", "))));
  for (const auto& problem : plan.problems)
    err << fmt::format("iotcloud: {} on {}: {}\n", printable(problem.name), printable(problem.gateway),
                       printable(problem.text));
}

/// What a plan says of topologies, and what became of it. \param outcomes empty: nothing was done yet
Json to_json(const TopologyPlan& plan, const std::vector<FleetStepOutcome>& outcomes = {}) {
  Json changes = Json::array();
  for (std::size_t i = 0; i < plan.steps.size(); ++i) {
    const auto& step = plan.steps[i];
    Json change{{"change", to_string(step.kind)}, {"topology", step.topology}, {"what", step.what}};
    if (!outcomes.empty()) {
      change["outcome"] = outcomes[i].outcome;
      change["reason"] = outcomes[i].reason;
    }
    changes.push_back(std::move(change));
  }
  Json problems = Json::array();
  for (const auto& [topology, text] : plan.problems) problems.push_back({{"topology", topology}, {"text", text}});
  return {{"changes", std::move(changes)},
          {"problems", std::move(problems)},
          {"kept", discovery::json_of<Json>(plan.kept)},
          {"same", plan.same}};
}

bool is_empty(const TopologyPlan& plan) {
  return plan.steps.empty() && plan.problems.empty() && plan.kept.empty() && plan.same == 0;
}

/// "nothing to do: 3 instances, 1 topology as the manifest says"
std::string nothing_to_do(const FleetPlan& plan, const TopologyPlan& topologies) {
  const std::string more =
      topologies.same == 0 ? "" : fmt::format(", {} topolog{}", topologies.same, topologies.same == 1 ? "y" : "ies");
  return fmt::format("nothing to do: {}{} as the manifest says\n", instances(plan.same), more);
}

/// Prints the steps of topologies, and what became of them. \param outcomes empty: nothing was done yet
void print_topologies(const TopologyPlan& plan, const std::vector<FleetStepOutcome>& outcomes, Call& call) {
  Rows rows;
  for (std::size_t i = 0; i < plan.steps.size(); ++i) {
    const auto& step = plan.steps[i];
    rows.push_back({printable(step.topology), to_string(step.kind)});
    if (outcomes.empty()) {
      rows.back().push_back(printable(fmt::format("{}", fmt::join(step.what, "; "))));
    } else {
      rows.back().insert(rows.back().end(), {outcomes[i].outcome, printable(outcomes[i].reason)});
    }
  }
  if (!rows.empty() && outcomes.empty()) print_table(call.out, {"TOPOLOGY", "CHANGE", "WHAT"}, rows);
  if (!rows.empty() && !outcomes.empty()) print_table(call.out, {"TOPOLOGY", "CHANGE", "OUTCOME", "REASON"}, rows);
  for (const auto& topology : plan.kept)
    call.out << fmt::format("kept, though the manifest does not name it any more: topology {}\n", printable(topology));
  for (const auto& [topology, text] : plan.problems)
    call.err << fmt::format("iotcloud: topology {}: {}\n", printable(topology), printable(text));
}

int show_plan(Call& call, const Manifest& manifest, const FleetPlan& plan, const TopologyPlan& topologies) {
  const bool has_problems = !plan.problems.empty() || !topologies.problems.empty();
  const bool has_steps = !plan.steps.empty() || !topologies.steps.empty();
  const int status = has_problems ? exit_failed : has_steps ? exit_differs : exit_ok;
  if (call.format != Format::table) {
    Json changes = Json::array();
    for (const auto& step : plan.steps) changes.push_back(to_json(step));
    Json answer{{"fleet", manifest.fleet}, {"changes", changes}};
    answer.update(rest_of(plan));
    if (!is_empty(topologies)) answer["topologies"] = to_json(topologies);
    print_data(call.out, call.format, answer);
    return status;
  }
  if (!has_steps) call.out << nothing_to_do(plan, topologies);
  if (!plan.steps.empty()) {
    Rows rows;
    for (const auto& step : plan.steps)
      rows.push_back({printable(step.gateway), printable(full_name(step)), to_string(step.kind),
                      printable(fmt::format("{}", fmt::join(step.what, "; ")))});
    print_table(call.out, {"GATEWAY", "NAME", "CHANGE", "WHAT"}, rows);
  }
  print_topologies(topologies, {}, call);
  tell_rest(plan, call.out, call.err);
  return status;
}

/// Prints a line for each gateway whose changes were not all done.
void name_failures(const FleetPlan& plan, const std::vector<FleetStepOutcome>& outcomes, std::ostream& err) {
  struct Tally {
    std::size_t all = 0, open = 0;
    std::string first;
  };
  std::map<discovery::GatewayId, Tally> gateways;
  for (std::size_t i = 0; i < outcomes.size(); ++i) {
    auto& tally = gateways[plan.steps[i].gateway];
    ++tally.all;
    if (outcomes[i].outcome == "done") continue;
    if (tally.open++ == 0) tally.first = fmt::format("{}: {}", outcomes[i].outcome, outcomes[i].reason);
  }
  for (const auto& [gateway, tally] : gateways) {
    if (tally.open == 0) continue;
    err << fmt::format("iotcloud: {}: {} of {} changes not done; the first: {}\n", printable(gateway), tally.open,
                       tally.all, printable(tally.first));
  }
}

int show_outcomes(Call& call, const Manifest& manifest, const FleetPlan& plan,
                  const std::vector<FleetStepOutcome>& outcomes, const TopologyPlan& topologies,
                  const std::vector<FleetStepOutcome>& of_topologies) {
  bool ok = plan.problems.empty() && topologies.problems.empty();
  for (const auto* all : {&outcomes, &of_topologies}) {
    for (const auto& outcome : *all) ok = ok && outcome.outcome == "done";
  }
  if (call.format != Format::table) {
    Json changes = Json::array();
    for (std::size_t i = 0; i < outcomes.size(); ++i) {
      Json change = to_json(plan.steps[i]);
      change["outcome"] = outcomes[i].outcome;
      change["reason"] = outcomes[i].reason;
      changes.push_back(std::move(change));
    }
    Json answer{{"fleet", manifest.fleet}, {"ok", ok}, {"changes", changes}};
    answer.update(rest_of(plan));
    if (!is_empty(topologies)) answer["topologies"] = to_json(topologies, of_topologies);
    print_data(call.out, call.format, answer);
    return ok ? exit_ok : exit_failed;
  }
  if (plan.steps.empty() && topologies.steps.empty()) call.out << nothing_to_do(plan, topologies);
  if (!plan.steps.empty()) {
    Rows rows;
    for (std::size_t i = 0; i < outcomes.size(); ++i) {
      const auto& step = plan.steps[i];
      rows.push_back({printable(step.gateway), printable(full_name(step)), to_string(step.kind), outcomes[i].outcome,
                      printable(outcomes[i].reason)});
    }
    print_table(call.out, {"GATEWAY", "NAME", "CHANGE", "OUTCOME", "REASON"}, rows);
    name_failures(plan, outcomes, call.err);
  }
  print_topologies(topologies, of_topologies, call);
  tell_rest(plan, call.out, call.err);
  return ok ? exit_ok : exit_failed;
}

/// Reports progress, at most once a second.
std::function<void(std::size_t, std::size_t)> progress_to(std::optional<WaitingReport>& waiting) {
  using Clock = std::chrono::steady_clock;
  return [&waiting, last = Clock::now()](std::size_t done, std::size_t all) mutable {
    if (done == all || Clock::now() - last < std::chrono::seconds(1)) return;
    last = Clock::now();
    waiting->say(fmt::format("iotcloud: {} of {} changes\n", done, all));
  };
}

/// \return whether a plan changes an instance.
WaitingReport::Concerns is_changed_by(const FleetPlan& plan) {
  std::set<discovery::InstanceId> there;
  std::set<std::pair<discovery::GatewayId, std::string>> deployed;
  for (const auto& step : plan.steps) {
    if (step.kind == FleetStepKind::deploy || step.kind == FleetStepKind::replace)
      deployed.emplace(step.gateway, full_name(step));
    if (!step.instance.empty()) there.insert(step.instance);
  }
  return [there = std::move(there), deployed = std::move(deployed)](const discovery::DriverRecord& driver) {
    return there.contains(driver.instance) ||
           deployed.contains({driver.gateway, fmt::format("{}/{}", driver.deployment, driver.index)});
  };
}

class OfManifest : public Verb {
 public:
  using Verb::Verb;
  void declare(CLI::App& options) override {
    options.add_option("-f,--file", file_, "the manifest; config/fleet.yaml is a commented one")
        ->required()
        ->type_name("FILE");
    options.add_flag_callback(
        "--no-prune", [this] { plan_options_.prune = false; },
        "leave what an earlier apply of this manifest deployed and it does not name any more");
    options.add_flag("--adopt", plan_options_.adopt,
                     "take instances over that others deployed under names of the manifest; without it they are left "
                     "alone");
  }
  int run(Call& call) override {
    auto manifest = load_manifest(file_);
    look_at_topologies(manifest);
    const auto master = call.connect();
    check_properties(call, manifest, *master);
    const auto plan = make_plan(manifest, read_fleet(*master), plan_options_);
    const auto topologies =
        make_topology_plan(manifest, present_topologies(*master), plan_options_.prune, plan_options_.adopt);
    return follow(call, manifest, plan, topologies);
  }

 protected:
  virtual int follow(Call& call, const Manifest& manifest, const FleetPlan& plan, const TopologyPlan& topologies) = 0;

 private:
  static void check_properties(Call& call, const Manifest& manifest, MasterClient& master) {
    PluginDeclarations on_gateways(master);
    cli::check_properties(manifest, [&](const ManifestDeployment& deployment) -> std::vector<DeclaredPlugin> {
      if (!deployment.declared.empty()) return {{deployment.file, deployment.declared.front()}};
      return on_gateways.of(deployment.plugin, deployment.gateways);
    });
    tell_unchecked(on_gateways, call.err);
  }

  std::string file_;
  FleetPlanOptions plan_options_;
};

class Diff final : public OfManifest {
 public:
  Diff()
      : OfManifest({"diff", "Show what apply would change; exit status 4 when there is something",
                    "iotcloud diff -f fleet.yaml", security::Role::operating}) {}

 private:
  int follow(Call& call, const Manifest& manifest, const FleetPlan& plan, const TopologyPlan& topologies) override {
    return show_plan(call, manifest, plan, topologies);
  }
};

class Apply final : public OfManifest {
 public:
  Apply()
      : OfManifest({"apply",
                    "Make the fleet as a manifest says: deploy what is missing, change what differs, undeploy what an "
                    "earlier apply of it deployed and it does not name any more. Nothing else is touched. Another "
                    "plugin comes to one gateway after the other, and when one does not come up with it, all go back",
                    "iotcloud apply -f fleet.yaml", security::Role::admin}) {}

  void declare(CLI::App& options) override {
    OfManifest::declare(options);
    options.add_flag("--dry-run", dry_run_, "only show what would change, as diff");
    add_wait(options, apply_options_.wait);
    add_settle(options, apply_options_.settle);
  }

 private:
  int follow(Call& call, const Manifest& manifest, const FleetPlan& plan, const TopologyPlan& topologies) override {
    if (dry_run_) return show_plan(call, manifest, plan, topologies);
    apply_options_.connect = [&call] { return call.connect(); };
    if (call.progress) apply_options_.terminal = &call.err;
    std::optional<WaitingReport> waiting;
    apply_options_.on_orders = [&] {
      if (!plan.steps.empty()) waiting.emplace(call, is_changed_by(plan));
    };
    apply_options_.progress = progress_to(waiting);
    const auto outcomes = apply(manifest, plan, apply_options_);
    waiting.reset();
    const auto of_topologies = apply_topologies(manifest, topologies, apply_options_);
    return show_outcomes(call, manifest, plan, outcomes, topologies, of_topologies);
  }

  bool dry_run_ = false;
  ApplyOptions apply_options_;
};

}  // namespace

void add_fleet_verbs(Verbs& verbs) {
  verbs.add<Diff>();
  verbs.add<Apply>();
}

}  // namespace iotcloud::master::cli
