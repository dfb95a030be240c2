#include <fmt/format.h>

#include <iotcloud/config/yaml.h>
#include <iotcloud/master/cli/fleet/apply_topologies.h>
#include <iotcloud/master/cli/plugins/plugin_file.h>
#include <iotcloud/master/cli/topology/submission.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master::cli {

namespace {

/// The digest that the topology would have as it is here now.
std::string digest_of_files(const CheckedTopology& checked) {
  std::vector<discovery::SentLibrary> libraries;
  for (const auto& library : checked.libraries)
    libraries.push_back({library.name, "", security::sha256_hex(plugin_bytes(library.path))});
  return digest_of(checked.yaml, libraries);
}

FleetStepOutcome outcome_of(const OrderResult& result) {
  if (result.refusal != OrderRefusal::none) return {"failed", result.text};
  return {result.all_done() ? "done" : "failed", result.all_done() ? "" : result.summary()};
}

FleetStepOutcome kill(const discovery::TopologyName& topology, MasterClient& master, const WaitLimit& wait) {
  TopologyRequest request;
  request.topology = topology;
  request.change = TopologyChange::kill;
  request.wait = wait;
  const auto result = master.order(request);
  return {result.all_done() ? "done" : "failed", result.all_done() ? "" : result.summary()};
}

}  // namespace

void look_at_topologies(Manifest& manifest) {
  for (auto& topology : manifest.topologies) {
    const auto refuse = [&](const std::string& why) {
      return config::ConfigError(topology.place, fmt::format("topologies.{}", topology.name), why, "");
    };
    try {
      const auto checked = check_file(topology.file);
      check_workers(checked, topology.workers);
      if (checked.name != topology.name)
        throw config::Error(fmt::format("its file calls it {} (topology.name)", checked.name));
      topology.digest = digest_of_files(checked);
    } catch (const std::exception& error) {
      throw refuse(error.what());
    }
  }
}

std::vector<PresentTopology> present_topologies(MasterClient& master) {
  std::vector<PresentTopology> present;
  for (const auto& topology : master.topologies())
    present.push_back({topology.record.name, topology.digest, topology.wanted_workers, topology.manager});
  return present;
}

std::vector<FleetStepOutcome> apply_topologies(const Manifest& manifest, const TopologyPlan& plan,
                                               const ApplyOptions& options) {
  std::vector<FleetStepOutcome> outcomes;
  if (plan.steps.empty()) return outcomes;
  const auto master = options.connect();
  for (const auto& step : plan.steps) {
    try {
      if (step.kind == TopologyStepKind::kill) {
        outcomes.push_back(kill(step.topology, *master, options.wait));
        continue;
      }
      const auto& wanted = manifest.topologies.at(step.number);
      SubmitRequest request;
      request.workers = wanted.workers;
      request.manager = manifest.fleet;
      request.wait = options.wait;
      request.settle = options.settle;
      std::vector<InstanceOutcome> failures;  // a pool that lacks a library gets no worker
      prepare(request, wanted.file, *master, options.terminal, failures);
      outcomes.push_back(outcome_of(give(request, step.kind != TopologyStepKind::submit, *master)));
    } catch (const std::exception& error) {  // Unreachable, RequestFailed, a file that is gone meanwhile
      outcomes.push_back({"failed", error.what()});
    }
  }
  return outcomes;
}

}  // namespace iotcloud::master::cli
