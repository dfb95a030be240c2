#pragma once

#include <iotcloud/topology/definition/definition.h>

namespace iotcloud::topology {

/// Places the calling thread, and all threads that it and they start from now on: on which cores they run, whether
/// others may take these from them, and whether their memory may be paged out. Call it before the worker is made.
/// \throws config::Error that names the key, says what the system refused, and how to allow it.
void place_threads(const PlacementSettings& placement);

}  // namespace iotcloud::topology
