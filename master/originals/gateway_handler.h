#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/rpc/session.h>
#include <iotcloud/rpc/thrift_server.h>

namespace iotcloud::master {

class OriginalGateways;
struct MasterStatus;

/// Who may call the master as a gateway of the original system, which shows neither token nor certificate: root, the
/// master's own user, and these.
struct OriginalAccess {
  std::vector<std::string> users{};             ///< accounts of this machine
  bool open = false;                            ///< everybody on this machine
  std::shared_ptr<security::AuditLog> audit{};  ///< null: no audit log
  rpc::CallsByRole calls = rpc::usual_calls();  ///< how many calls each of them may make
};

/// Serves TMasterService, which gateways of the original system call to register. A standby master refuses them and
/// names the leader. The first two arguments outlive all connections. \param status returns the status of the serving
/// master.
rpc::ThriftService serve_original_gateways(OriginalGateways& gateways, std::function<MasterStatus()> status,
                                           OriginalAccess access = {});

}  // namespace iotcloud::master
