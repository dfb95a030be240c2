#pragma once

#include <memory>

#include <iotcloud/discovery/client/connection.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {

/// The registry that `connection` leads to; connects in the background. `options.url` is for messages only.
std::unique_ptr<Registry> make_client(std::unique_ptr<Connection> connection, const RegistryOptions& options);

}  // namespace iotcloud::discovery
