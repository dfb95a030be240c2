#pragma once

#include <map>
#include <string>
#include <vector>

#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/plugin.h>

namespace iotcloud::topology {

/// Loads the libraries of `topology.library` and lets them register their components.
/// \param folders where to look for libraries that are not beside the YAML file, in this order.
/// \param known paths of libraries, by how `topology.library` names them; those that are not in it are looked for.
/// \return the paths of all. \throws config::ConfigError at `topology.library`.
std::vector<std::string> load_libraries(const TopologyDefinition& definition, const std::vector<std::string>& folders,
                                        ComponentRegistry& components,
                                        const std::map<std::string, std::string>& known = {});

/// Reads a topology's YAML, loads its component libraries and puts the graph together, as a worker does; contacts no
/// registry and no broker. Accepts a file without a registry, because local mode needs none.
/// \param components linked-in components, in addition to those of `topology.library`.
/// \return the text of describe(). \throws config::ConfigError.
std::string check_topology(const std::string& file, const std::vector<std::string>& folders,
                           ComponentRegistry components = {});

/// Checks a topology as check_topology() does, for `iotcloud topology submit`; the files that it names for its workers
/// (passwords, keys, tokens) need not be on this machine. \return a JSON object of one line:
/// `topology`, `libraries` (each with `name`, as the YAML has it, and `path`), `crossings` (crossings(): why several
/// workers may not run it) and `registry`; or `error`: what is wrong.
std::string check_submission(const std::string& file, const std::vector<std::string>& folders);

/// Loads a component library as a worker does. \return a JSON object of one line: what it registers, or `error`: why it
/// cannot be loaded.
std::string check_library(const std::string& file);

}  // namespace iotcloud::topology
