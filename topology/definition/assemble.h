#pragma once

#include <functional>

#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

/// Makes the factories of spouts and bolts that use brokers. Such a factory makes one object for each task and one more
/// for the check of the graph, so making an object must be cheap and must not connect to anything.
struct EndpointFactories {
  std::function<SpoutFactory(const ComponentDefinition&)> spout;
  std::function<BoltFactory(const ComponentDefinition&)> bolt;
};

/// Puts the graph together, from the YAML file and the application of the component libraries, and checks it. \throws
/// config::ConfigError for an unknown class and for every error of TopologyBuilder::build, at the component's place in
/// the file (at `topology.library` for a component that is not in the file).
Topology assemble(const TopologyDefinition& definition, const ComponentRegistry& components,
                  const EndpointFactories& endpoints);

}  // namespace iotcloud::topology
