#pragma once

#include <string>

#include <iotcloud/discovery/ids.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

/// Two topologies of one name would read the same channels as one group: each would get a part of the drivers only.
namespace iotcloud::discovery {

/// Who keeps workers of ours from running a topology of this name, because Apache Storm runs one, and how to mend it,
/// as a text for people; empty: nobody. Only one of Storm's with spouts that face brokers can be found, and no other
/// reads what ours would. \throws RegistryError
std::string taken_by_storm(Registry& registry, const Paths& paths, const TopologyName& topology);
/// Who keeps Apache Storm from running a topology of this name, because workers of ours run one, and how to mend it, as
/// a text for people; empty: nobody. \throws RegistryError
std::string taken_by_workers(Registry& registry, const Paths& paths, const TopologyName& topology);

}  // namespace iotcloud::discovery
