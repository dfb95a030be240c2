#pragma once

#include <string>

namespace iotcloud::master {

/// Whether a driver's property looks like a secret: by its name ("password", "api_key", "auth.token"), or because its
/// value is, or lists, a URL with a password.
bool is_secret(const std::string& key, const std::string& value);

/// The URL with "***" in the place of its password.
std::string without_password(const std::string& url);

}  // namespace iotcloud::master
