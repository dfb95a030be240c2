#pragma once

#include <string>

#include <iotcloud/discovery/ids.h>

namespace iotcloud::discovery {

/// The id of an instance with this deployment name and number on this gateway. It is always the same (a UUID of version
/// 5 without dashes), so that an instance that is deployed again keeps the names of its channels and its spool.
InstanceId named_instance_id(const GatewayId& gateway, const std::string& name, int index);

}  // namespace iotcloud::discovery
