#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <iotcloud/master/cli/fleet/manifest.h>

namespace iotcloud::master::cli {

/// A topology that pools of workers run now.
struct PresentTopology {
  discovery::TopologyName name;
  std::string digest;   ///< of its YAML and libraries (TopologyVersion::digest)
  int workers = 0;      ///< that it is to have; 0: it was not submitted, and its workers were started by hand
  std::string manager;  ///< the manifest that it belongs to; empty: a person submitted it
};

/// The kinds of steps, in the order in which they are done.
enum class TopologyStepKind { kill, adopt, update, submit };
std::string to_string(TopologyStepKind kind);

/// One thing to do with one topology.
struct TopologyStep {
  TopologyStepKind kind = TopologyStepKind::submit;
  discovery::TopologyName topology;
  std::size_t number = 0;         ///< index in Manifest::topologies; unused for `kill`
  std::vector<std::string> what;  ///< the differences, for people: "workers: 1 -> 2"
};

/// The differences between a manifest's topologies and those that the pools run.
struct TopologyPlan {
  std::vector<TopologyStep> steps;  ///< in the order of TopologyStepKind
  /// By topology: what the manifest wants and cannot have, and how to mend it.
  std::vector<std::pair<discovery::TopologyName, std::string>> problems;
  std::vector<discovery::TopologyName> kept;  ///< what pruning would kill, when it is not wanted
  std::size_t same = 0;
};

/// Plans the steps that make the pools run the manifest's topologies, and no others. A topology that the manifest did
/// not submit is never touched, unless it has a name of the manifest's and may be adopted. \param prune, adopt as in
/// FleetPlanOptions
TopologyPlan make_topology_plan(const Manifest& manifest, const std::vector<PresentTopology>& present, bool prune,
                                bool adopt);

}  // namespace iotcloud::master::cli
