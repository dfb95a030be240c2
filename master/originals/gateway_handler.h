#pragma once

#include <functional>

#include <iotcloud/rpc/thrift_server.h>

namespace iotcloud::master {

class OriginalGateways;
struct MasterStatus;

/// Serves TMasterService, which gateways of the original system call to register. A standby master refuses them and
/// names the leader. The arguments outlive all connections. \param status returns the status of the serving master.
rpc::ThriftService serve_original_gateways(OriginalGateways& gateways, std::function<MasterStatus()> status);

}  // namespace iotcloud::master
