#pragma once

#include <iotcloud/config/yaml.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {

/// Reads the keys for the registry that every process has besides its URL: `registry.session_timeout`, `registry.user`,
/// `registry.password_file` (the password is its first line) or `registry.password_variable` (of the environment), and
/// `registry.users` (a file, access.h), `registry.others_may_read` and `registry.open`. They are at the top of a file,
/// with the dot in the key. Leaves the URL empty. \throws config::ConfigError
RegistryOptions read_registry_options(config::YamlSection& top);

}  // namespace iotcloud::discovery
