#pragma once

#include <memory>

#include <iotcloud/master/console/console_calls.h>
#include <iotcloud/rpc/thrift_server.h>

namespace iotcloud::master {

/// Calls of the master's own API: its roles, limits and audit log count for people at the console, too.
/// \param api as serve_api() makes it
std::unique_ptr<ConsoleCalls> calls_of_api(rpc::ThriftService api);

}  // namespace iotcloud::master
