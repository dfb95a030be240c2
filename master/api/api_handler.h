#pragma once

#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/master/api/worker_pages.h>
#include <iotcloud/master/gateways/plugin_uploads.h>
#include <iotcloud/rpc/session.h>
#include <iotcloud/rpc/thrift_server.h>

namespace iotcloud::master {

class Master;

/// The role that each method of TMasterAPIService requires. The API refuses a method that is not listed here.
const rpc::MethodRules& api_rules();

/// Access control and limits of the API.
struct ApiAccess {
  std::shared_ptr<security::TokenKeeper> tokens;  ///< null: no token is required, and the peer's user counts
  std::vector<std::string> users{};               ///< without tokens: accounts that may act (rpc::AccessOptions)
  bool open = false;                              ///< without tokens: everybody may act
  std::shared_ptr<security::AuditLog> audit;      ///< null: no audit log
  GatewayAccess gateways;
  WorkerAccess workers;
  PoolAccess pools{};
  std::chrono::milliseconds wrong_token_pause{1'000};
  rpc::CallsByRole calls = rpc::usual_calls();     ///< how many calls each identity may make
  std::shared_ptr<rpc::CallLimits> token_tries{};  ///< rpc::AccessOptions; null: as usual
  PluginUploads::Options uploads{};
};

/// Serves TMasterAPIService for a master, with one handler for each connection.
/// \param master outlives all connections.
rpc::ThriftService serve_api(Master& master, ApiAccess access = {});

}  // namespace iotcloud::master
