#pragma once

#include <functional>
#include <string>

#include <iotcloud/rpc/http/http_server.h>

namespace iotcloud::rpc {

/// Answers a GET of /healthz: 200 and "ok", or 503 and the reason.
/// \param trouble why the daemon is unhealthy, in one line; empty if it is healthy. Called on the server's thread.
HttpHandler health_page(std::function<std::string()> trouble);

}  // namespace iotcloud::rpc
