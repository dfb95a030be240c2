#pragma once

#include <string>

namespace iotcloud::security {

/// The credentials of a user of the registry.
struct RegistryPassword {
  std::string password;  ///< 64 hexadecimal digits: nobody finds it by its digest
  std::string digest;    ///< as ZooKeeper's digest authentication has it: base64 of SHA-1 of "USER:PASSWORD"
};
/// 64 hexadecimal digits that nobody can guess. \throws config::Error if the system gives no random numbers.
std::string random_hex();

/// \throws config::Error as random_hex().
RegistryPassword new_registry_password(const std::string& user);

/// ZooKeeper's digest of this user's password.
std::string registry_digest(const std::string& user, const std::string& password);

}  // namespace iotcloud::security
