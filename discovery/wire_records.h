#pragma once

#include "iotcloud/discovery/records_types.h"
#include <iotcloud/discovery/records.h>

/// Converts drivers' records into the Thrift structs that the registry holds, and back, where as_wire() and as_own()
/// (description/wire.h) are not enough. For sources that put records into Thrift messages of their own; heavy to
/// include.
namespace iotcloud::discovery {

/// The struct that encode() writes as bytes.
wire::TSensor to_wire(const DriverRecord& record);
/// \param path for messages. \throws config::Error when a value in the struct is invalid.
DriverRecord from_wire(wire::TSensor sensor, const std::string& path);

}  // namespace iotcloud::discovery
