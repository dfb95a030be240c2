#pragma once

#include <string>
#include <vector>

#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/plugin.h>

namespace iotcloud::topology {

/// Loads the libraries of `topology.library` and lets them register their components.
/// \param folders where to look for libraries that are not beside the YAML file, in this order.
/// \return their paths. \throws config::ConfigError at `topology.library`.
std::vector<std::string> load_libraries(const TopologyDefinition& definition, const std::vector<std::string>& folders,
                                        ComponentRegistry& components);

/// Reads a topology's YAML, loads its component libraries and puts the graph together, as a worker does; contacts no
/// registry and no broker. Accepts a file without a registry, because local mode needs none.
/// \param components linked-in components, in addition to those of `topology.library`.
/// \return the text of describe(). \throws config::ConfigError.
std::string check_topology(const std::string& file, const std::vector<std::string>& folders,
                           ComponentRegistry components = {});

/// Loads a component library as a worker does. \return a JSON object of one line: what it registers, or `error`: why it
/// cannot be loaded.
std::string check_library(const std::string& file);

}  // namespace iotcloud::topology
