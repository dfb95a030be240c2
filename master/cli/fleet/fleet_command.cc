#include <chrono>
#include <map>
#include <ostream>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/master/cli/fleet/apply.h>
#include <iotcloud/master/cli/fleet/fleet_command.h>
#include <iotcloud/master/cli/fleet/manifest.h>
#include <iotcloud/master/cli/fleet/plan.h>
#include <iotcloud/master/cli/master_client.h>
#include <iotcloud/master/cli/output.h>

namespace iotcloud::master::cli {

namespace {

using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;

Fleet read_fleet(MasterClient& master) {
  Fleet fleet;
  for (auto& site : master.gateways())
    fleet.gateways.push_back({site.siteId, site.draining, site.original, !site.alive});
  std::map<std::string, std::string> failures;
  for (auto& driver : master.drivers()) {
    if (driver.exactState == "failed")
      failures[driver.sensorId] = driver.reason.empty() ? "the gateway gave no reason" : driver.reason;
  }
  for (auto& order : master.orders()) {
    fleet.instances.push_back({order.gateway, order.instance, order.name, order.index, order.manager, order.driver,
                               order.plugin, order.active, std::move(order.properties), std::move(order.metadata),
                               failures[order.instance], order.sha256, std::move(order.hidden)});
  }
  return fleet;
}

std::string full_name(const Step& step) {
  return fmt::format("{}/{}", step.name, step.index);
}

std::string instances(std::size_t count) {
  return fmt::format("{} instance{}", count, count == 1 ? "" : "s");
}

Json to_json(const Step& step) {
  return {{"change", to_string(step.kind)}, {"gateway", step.gateway}, {"name", step.name}, {"index", step.index},
          {"instance", step.instance},      {"what", step.what}};
}

Json rest_of(const Plan& plan) {
  Json problems = Json::array();
  for (const auto& problem : plan.problems)
    problems.push_back({{"gateway", problem.gateway}, {"name", problem.name}, {"text", problem.text}});
  Json kept = Json::array();
  for (const auto& step : plan.kept)
    kept.push_back(
        {{"gateway", step.gateway}, {"name", step.name}, {"index", step.index}, {"instance", step.instance}});
  return {{"problems", problems},
          {"kept", kept},
          {"passed_by", plan.passed_by},
          {"same", plan.same},
          {"not_compared", plan.not_compared}};
}

/// What a person should know besides the steps.
void tell_rest(const Plan& plan, std::ostream& out, std::ostream& err) {
  if (!plan.kept.empty())
    out << fmt::format("kept, though the manifest does not name them any more: {}\n", instances(plan.kept.size()));
  for (const auto& gateway : plan.passed_by) out << fmt::format("passed by: {} is draining\n", printable(gateway));
  if (!plan.not_compared.empty())
    out << fmt::format("not compared, for only an admin may see them: {}\n",
                       printable(fmt::format("{}", fmt::join(plan.not_compared, ", "))));
  for (const auto& problem : plan.problems)
    err << fmt::format("iotcloud: {} on {}: {}\n", printable(problem.name), printable(problem.gateway),
                       printable(problem.text));
}

int show_plan(const Command& command, const Manifest& manifest, const Plan& plan, std::ostream& out,
              std::ostream& err) {
  const int status = !plan.problems.empty() ? exit_failed : plan.steps.empty() ? exit_ok : exit_differs;
  if (command.format != Format::table) {
    Json changes = Json::array();
    for (const auto& step : plan.steps) changes.push_back(to_json(step));
    Json answer{{"fleet", manifest.fleet}, {"changes", changes}};
    answer.update(rest_of(plan));
    print_data(out, command.format, answer);
    return status;
  }
  if (plan.steps.empty()) {
    out << fmt::format("nothing to do: {} as the manifest says\n", instances(plan.same));
  } else {
    Rows rows;
    for (const auto& step : plan.steps)
      rows.push_back({printable(step.gateway), printable(full_name(step)), to_string(step.kind),
                      printable(fmt::format("{}", fmt::join(step.what, "; ")))});
    print_table(out, {"GATEWAY", "NAME", "CHANGE", "WHAT"}, rows);
  }
  tell_rest(plan, out, err);
  return status;
}

/// A line for each gateway on which not all was done.
void name_failures(const Plan& plan, const std::vector<StepOutcome>& outcomes, std::ostream& err) {
  struct Tally {
    std::size_t all = 0, open = 0;
    std::string first;
  };
  std::map<std::string, Tally> gateways;
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

int show_outcomes(const Command& command, const Manifest& manifest, const Plan& plan,
                  const std::vector<StepOutcome>& outcomes, std::ostream& out, std::ostream& err) {
  bool ok = plan.problems.empty();
  for (const auto& outcome : outcomes) ok = ok && outcome.outcome == "done";
  if (command.format != Format::table) {
    Json changes = Json::array();
    for (std::size_t i = 0; i < outcomes.size(); ++i) {
      Json change = to_json(plan.steps[i]);
      change["outcome"] = outcomes[i].outcome;
      change["reason"] = outcomes[i].reason;
      changes.push_back(std::move(change));
    }
    Json answer{{"fleet", manifest.fleet}, {"ok", ok}, {"changes", changes}};
    answer.update(rest_of(plan));
    print_data(out, command.format, answer);
    return ok ? exit_ok : exit_failed;
  }
  if (plan.steps.empty()) {
    out << fmt::format("nothing to do: {} as the manifest says\n", instances(plan.same));
  } else {
    Rows rows;
    for (std::size_t i = 0; i < outcomes.size(); ++i) {
      const auto& step = plan.steps[i];
      rows.push_back({printable(step.gateway), printable(full_name(step)), to_string(step.kind), outcomes[i].outcome,
                      printable(outcomes[i].reason)});
    }
    print_table(out, {"GATEWAY", "NAME", "CHANGE", "OUTCOME", "REASON"}, rows);
    name_failures(plan, outcomes, err);
  }
  tell_rest(plan, out, err);
  return ok ? exit_ok : exit_failed;
}

/// Says how far it is, but not all the time.
std::function<void(std::size_t, std::size_t)> progress_to(std::ostream& err) {
  using Clock = std::chrono::steady_clock;
  return [&err, last = Clock::now()](std::size_t done, std::size_t all) mutable {
    if (done == all || Clock::now() - last < std::chrono::seconds(1)) return;
    last = Clock::now();
    err << fmt::format("iotcloud: {} of {} changes\n", done, all) << std::flush;
  };
}

}  // namespace

int run_fleet(const Command& command, const std::function<std::unique_ptr<MasterClient>()>& connect, std::ostream& out,
              std::ostream& err) {
  const auto manifest = load_manifest(command.file);
  const auto plan = make_plan(manifest, read_fleet(*connect()), {command.prune, command.adopt});
  if (command.verb == Verb::diff || command.dry_run) return show_plan(command, manifest, plan, out, err);
  ApplyOptions options;
  options.connect = connect;
  options.wait_ms = command.wait_ms;
  options.settle_ms = command.settle_ms;
  options.progress = progress_to(err);
  if (command.progress) options.terminal = &err;
  return show_outcomes(command, manifest, plan, apply(manifest, plan, options), out, err);
}

}  // namespace iotcloud::master::cli
