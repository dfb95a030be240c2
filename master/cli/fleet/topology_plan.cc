#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/master/cli/fleet/topology_plan.h>

namespace iotcloud::master::cli {

namespace {

/// The step that a topology of the manifest needs, if any; or the problem.
void plan_one(const ManifestTopology& wanted, std::size_t number, const PresentTopology* there,
              const std::string& fleet, bool adopt, TopologyPlan& plan) {
  if (there == nullptr) {
    plan.steps.push_back({TopologyStepKind::submit, wanted.name, number, {}});
    return;
  }
  if (there->workers == 0) {
    plan.problems.emplace_back(wanted.name, "workers that were started by hand run a topology of this name: end them");
    return;
  }
  const bool own = there->manager == fleet;
  if (!own && !adopt) {
    plan.problems.emplace_back(wanted.name,
                               fmt::format("{} submitted a topology of this name: --adopt takes it over",
                                           there->manager.empty() ? "a person" : "the manifest " + there->manager));
    return;
  }
  TopologyStep step{own ? TopologyStepKind::update : TopologyStepKind::adopt, wanted.name, number, {}};
  if (wanted.digest != there->digest) step.what.emplace_back("its file, or a library, is another");
  if (wanted.workers != there->workers)
    step.what.push_back(fmt::format("workers: {} -> {}", there->workers, wanted.workers));
  if (own && step.what.empty()) {
    ++plan.same;
  } else {
    plan.steps.push_back(std::move(step));
  }
}

}  // namespace

std::string to_string(TopologyStepKind kind) {
  switch (kind) {
    case TopologyStepKind::kill:
      return "kill";
    case TopologyStepKind::adopt:
      return "adopt";
    case TopologyStepKind::update:
      return "update";
    case TopologyStepKind::submit:
      return "submit";
  }
  return "";
}

TopologyPlan make_topology_plan(const Manifest& manifest, const std::vector<PresentTopology>& present, bool prune,
                                bool adopt) {
  TopologyPlan plan;
  for (std::size_t number = 0; number < manifest.topologies.size(); ++number) {
    const auto& wanted = manifest.topologies[number];
    const auto there =
        std::find_if(present.begin(), present.end(), [&](const auto& one) { return one.name == wanted.name; });
    plan_one(wanted, number, there == present.end() ? nullptr : &*there, manifest.fleet, adopt, plan);
  }
  for (const auto& there : present) {
    const auto is_this = [&](const auto& wanted) { return wanted.name == there.name; };
    if (there.manager != manifest.fleet || there.workers == 0 ||
        std::any_of(manifest.topologies.begin(), manifest.topologies.end(), is_this))
      continue;
    if (prune) {
      plan.steps.push_back({TopologyStepKind::kill, there.name, 0, {}});
    } else {
      plan.kept.push_back(there.name);
    }
  }
  std::stable_sort(plan.steps.begin(), plan.steps.end(), [](const auto& a, const auto& b) { return a.kind < b.kind; });
  return plan;
}

}  // namespace iotcloud::master::cli
