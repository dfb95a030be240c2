#pragma once

#include <functional>

#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

/// Makes the spouts and bolts that face brokers. The factories make one object for each task and one more for the check
/// of the graph, so that making one must cost nothing and connect nowhere.
struct EndpointFactories {
  std::function<SpoutFactory(const ComponentDefinition&)> spout;
  std::function<BoltFactory(const ComponentDefinition&)> bolt;
};

/// Puts the merged graph together, the YAML's layer and what the application of the component libraries adds, and
/// checks it. \throws config::ConfigError for an unknown class or whatever TopologyBuilder::build refuses, at the
/// component's place in the file (for a component that is not in the file: at `topology.library`).
Topology assemble(const TopologyDefinition& definition, const ComponentRegistry& components,
                  const EndpointFactories& endpoints);

}  // namespace iotcloud::topology
