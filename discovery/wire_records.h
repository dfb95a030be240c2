#pragma once

#include "iotcloud/discovery/records_types.h"
#include <iotcloud/discovery/records.h>

/// Records as the Thrift structs that stand in the registry. For those who send them on in messages of their own; heavy
/// to include.
namespace iotcloud::discovery {

/// What encode() writes.
wire::TSensor to_wire(const DriverRecord& record);
wire::TSite to_wire(const GatewayRecord& record);

}  // namespace iotcloud::discovery
