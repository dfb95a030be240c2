#pragma once

#include "iotcloud/discovery/records_types.h"
#include <iotcloud/discovery/records.h>

/// Converts records into the Thrift structs that the registry holds, and back. For sources that put records into Thrift
/// messages of their own; heavy to include.
namespace iotcloud::discovery {

/// The struct that encode() writes as bytes.
wire::TSensor to_wire(const DriverRecord& record);
wire::TSite to_wire(const GatewayRecord& record);
/// \param path for messages. \throws config::Error when a value in the struct is invalid.
DriverRecord from_wire(wire::TSensor sensor, const std::string& path);
GatewayRecord from_wire(wire::TSite site);

}  // namespace iotcloud::discovery
