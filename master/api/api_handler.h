#pragma once

#include <iotcloud/config/access/session.h>
#include <iotcloud/config/thrift/thrift_server.h>
#include <iotcloud/master/api/gateway_pages.h>
#include <iotcloud/master/plugins/plugin_uploads.h>

namespace iotcloud::master {

class Master;

/// What each method of TMasterAPIService asks of who calls it. A new method states it here, or answers nobody.
const config::MethodRules& api_rules();

/// Whom the API serves.
struct ApiAccess {
  std::shared_ptr<config::TokenKeeper> tokens;  ///< null: nobody is asked for one
  std::shared_ptr<config::AuditLog> audit;      ///< null: none
  GatewayAccess gateways;
  std::chrono::milliseconds wrong_token_pause{1'000};
  PluginUploads::Options uploads{};
};

/// Serves TMasterAPIService from a master, with one handler for each connection.
/// \param master outlives all connections.
config::ThriftService serve_api(Master& master, ApiAccess access = {});

}  // namespace iotcloud::master
