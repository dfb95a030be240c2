#pragma once

#include <string>

#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

/// The graph for a reader: components in the order of the flow, each with executors and tasks, where it comes from
/// (broker, class, application), inputs with grouping and key, deadlines, keep_last, ticks, and the fields of what it
/// emits; at the end what several workers would not do together. Lines end with '\n'.
std::string describe(const TopologyDefinition& definition, const Topology& topology);

/// The inputs that reach across drivers without `scope: worker`, one to a line ("  bolt <- source, global\n"): tuples
/// of one driver meet in one worker, others do not. Empty: several workers may run the topology.
std::string crossings(const TopologyDefinition& definition, const Topology& topology);

}  // namespace iotcloud::topology
