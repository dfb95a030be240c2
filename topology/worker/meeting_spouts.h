#pragma once

#include <map>
#include <memory>
#include <string>

#include <iotcloud/topology/definition/definition.h>
#include <iotcloud/topology/endpoints/placement/partition_agreement.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology {

/// By spout that reads a driver: what its channels must agree with. Spouts of one driver have one object if their
/// tuples can come to one bolt, directly or through others. Bolts that only send to drivers do not count: they have no
/// state.
std::map<std::string, std::shared_ptr<PartitionAgreement>> agreements_by_spout(const TopologyDefinition& definition,
                                                                               const Topology& topology);

}  // namespace iotcloud::topology
