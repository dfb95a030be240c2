#pragma once

#include <functional>

#include <iotcloud/config/thrift/thrift_server.h>

namespace iotcloud::master {

class OriginalGateways;
struct MasterStatus;

/// Serves TMasterService, to which gateways of the original system register. A standby master refuses and names the
/// leader. The arguments outlive all connections. \param status of the master that serves.
config::ThriftService serve_original_gateways(OriginalGateways& gateways, std::function<MasterStatus()> status);

}  // namespace iotcloud::master
