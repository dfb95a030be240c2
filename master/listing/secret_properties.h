#pragma once

#include <string>

namespace iotcloud::master {

/// Whether a property that a driver was deployed with looks like a secret: by its name ("password", "api_key",
/// "auth.token"), or because its value is a URL with a password in it.
bool is_secret(const std::string& key, const std::string& value);

}  // namespace iotcloud::master
