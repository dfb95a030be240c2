#pragma once

#include <optional>
#include <string>

#include <sys/types.h>

#include <iotcloud/security/tokens.h>

namespace iotcloud::master {

/// A person at the console.
struct ConsoleCaller {
  std::optional<security::TokenEntry> holder;  ///< of the session; nullopt: without tokens
  std::optional<uid_t> user;                   ///< of this machine, without tokens
  std::string address;                         ///< "192.0.2.7:40112"
  std::string certificate;                     ///< subject; empty: none
};

/// What the console asks and orders on behalf of people. Thread safe; calls block.
class ConsoleCalls {
 public:
  virtual ~ConsoleCalls() = default;
  /// Finds whose token it is, as a client of the API would be told. \return why it is nobody's; empty: it counts
  virtual std::string authenticate(const ConsoleCaller& caller, const std::string& token) = 0;
  /// Asks or orders, with the rights of the caller. \param call its name (master/console/README.md) \param json its
  /// arguments, an object \return the answer, JSON. \throws config::Error that says why there is none
  virtual std::string call(const ConsoleCaller& caller, const std::string& call, const std::string& json) = 0;
};

}  // namespace iotcloud::master
