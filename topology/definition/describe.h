#pragma once

#include <string>

#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

/// Describes the graph for a reader: components in the order of the flow, each with executors and tasks, origin
/// (broker, class, application), inputs with grouping and key, deadlines, keep_last, ticks, and the fields that it
/// emits; at the end the inputs that several workers would process differently from one. Lines end with '\n'.
std::string describe(const TopologyDefinition& definition, const Topology& topology);

/// Lists the inputs that reach across drivers without `scope: worker`, one in a line ("  bolt <- source, global\n"):
/// only tuples of one driver always reach the same worker. Empty: several workers may run the topology.
std::string crossings(const TopologyDefinition& definition, const Topology& topology);

}  // namespace iotcloud::topology
