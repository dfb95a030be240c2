#pragma once

#include <map>
#include <string>

#include <iotcloud/topology/runtime/runtime.h>

namespace iotcloud::topology {

/// Says what a topology that ends has not done: how many tuples of which spouts are under way, before which bolts they
/// wait, and which bolts keep them by design (Bolt::holds_tuples_for), for people. Empty: all is done.
std::string left_behind(const Topology& topology, const Snapshot& snapshot);

/// By spout: the bolts below it that keep tuples by design, for people: "mean (for up to 10000 ms)". Spouts without
/// such bolts are missing.
std::map<std::string, std::string> keepers_by_spout(const Topology& topology);

}  // namespace iotcloud::topology
