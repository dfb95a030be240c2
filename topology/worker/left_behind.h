#pragma once

#include <string>

#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology {

/// Says what a topology that ends has not done: how many tuples of which spouts are under way, before which bolts they
/// wait, and which bolts keep them by design (Bolt::holds_tuples_for), for people. Empty: all is done.
std::string left_behind(const Topology& topology, const Snapshot& snapshot);

}  // namespace iotcloud::topology
