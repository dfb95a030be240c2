#pragma once

#include <string>
#include <vector>

#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology::storm {

/// A topology as Storm takes it.
struct Job {
  std::string name;
  std::string conf;                     ///< Storm's configuration of the topology, JSON
  std::string topology;                 ///< a StormTopology of nimbus/storm.thrift, in Thrift's binary protocol
  std::string file;                     ///< the topology's YAML; empty: component libraries alone, for Flux and Java
  std::vector<std::string> libraries;   ///< paths of its component libraries
  std::vector<std::string> nimbus;      ///< host:port of Storm's masters, if the file names them
  discovery::RegistryOptions registry;  ///< where its spouts and bolts find drivers; without a URL: it names none
  std::string zk_root;                  ///< TopologyDefinition::zk_root
  std::vector<std::string> notes;       ///< what holds on Storm in another way, a line for each
};

/// Reads a topology's file, loads its component libraries, puts the graph together and checks it, as a worker does, and
/// what Storm lacks (storm_limits.h); contacts nobody. \param folders where libraries are that are not beside the file.
/// \throws config::ConfigError
Job make_job(const std::string& file, const std::vector<std::string>& folders);

/// Component libraries alone, which a Flux file or a Java program names.
Job make_library_job(const std::string& library);

/// The graph as a StormTopology, in Thrift's binary protocol.
std::string to_storm(const TopologyDefinition& definition, const Topology& topology);
/// Storm's configuration of the topology, JSON.
std::string storm_conf(const TopologyDefinition& definition);

}  // namespace iotcloud::topology::storm
