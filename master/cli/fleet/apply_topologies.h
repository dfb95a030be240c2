#pragma once

#include <chrono>
#include <iosfwd>
#include <vector>

#include <iotcloud/master/cli/fleet/apply.h>
#include <iotcloud/master/cli/fleet/topology_plan.h>

namespace iotcloud::master::cli {

/// Looks at the files of the manifest's topologies and at their libraries, and sets their digests.
/// \throws config::ConfigError at the manifest's place of a topology that cannot be run, or is called otherwise
void look_at_topologies(Manifest& manifest);

/// The topologies that run, as the plan needs them.
std::vector<PresentTopology> present_topologies(MasterClient& master);

/// Does the steps, one after the other. \return an outcome for each
std::vector<FleetStepOutcome> apply_topologies(const Manifest& manifest, const TopologyPlan& plan,
                                               const ApplyOptions& options);

}  // namespace iotcloud::master::cli
