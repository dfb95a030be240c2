#pragma once

#include <string>

namespace iotcloud::master {

/// Whether a driver's property looks like a secret: by its name ("password", "api_key", "auth.token"), or because its
/// value is a URL with a password.
bool is_secret(const std::string& key, const std::string& value);

}  // namespace iotcloud::master
