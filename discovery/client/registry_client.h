#pragma once

#include <memory>

#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {

/// Makes a registry on a connection; it connects in the background. `options.url` is for messages only.
std::unique_ptr<Registry> make_client(std::unique_ptr<RegistryConnection> connection, const RegistryOptions& options);

}  // namespace iotcloud::discovery
