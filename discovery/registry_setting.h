#pragma once

#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {

/// Reads what every process says about the registry beside its URL: `registry.session_timeout`, `registry.user`,
/// `registry.password_file` (the password is its first line) or `registry.password_variable` (of the environment), and
/// `registry.others_may_read`. They stand at the top of a file, with the dot in the key. The URL is left empty.
/// \throws config::ConfigError
RegistryOptions read_registry_options(config::Section& top);

}  // namespace iotcloud::discovery
