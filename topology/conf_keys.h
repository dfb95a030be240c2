#pragma once

#include <string>
#include <vector>

#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology {

/// Refuses keys of a component's configuration that begin with `prefix` ("window.") and are not among `known`, so that
/// a misspelt key is not silently ignored. \throws std::invalid_argument that names the nearest known key.
void refuse_unknown_keys(const Config& config, const std::string& prefix, const std::vector<std::string>& known);

}  // namespace iotcloud::topology
