#pragma once

#include <functional>
#include <string>

#include <iotcloud/config/exposition/http_server.h>

namespace iotcloud::config {

/// The answer to a GET of /healthz: 200 and "ok", or 503 and why not.
/// \param trouble why the daemon is not well, in one line; empty: it is. Called on the server's thread.
HttpHandler health_page(std::function<std::string()> trouble);

}  // namespace iotcloud::config
