#pragma once

#include <string>
#include <vector>

#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology::storm {

/// Refuses what a topology asks for and Storm cannot do, or not as the topology means it: each at its place in the
/// file, with what to do instead. \return what holds there in another way, a line for each. \throws config::ConfigError
std::vector<std::string> check_limits(const TopologyDefinition& definition, const Topology& topology);

}  // namespace iotcloud::topology::storm
