#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <string>

#include <iotcloud/config/clock.h>

namespace iotcloud::gateway {

/// How long an instance may run without a confirmation by the registry that its gateway has its place: the properties
/// `on_partition` (`continue`, the default, or `stop`) and `lease` (a time, such as `30s`) of its deployment.
/// \return nullopt: without a limit. \throws config::Error for another word, for `stop` without a lease or with one
/// that is no time, and for a lease without `stop`.
std::optional<std::chrono::milliseconds> lease_of(const std::map<std::string, std::string>& properties);

/// \throws config::Error if the properties are invalid, or the lease is shorter than the gateway's session: such an
/// instance would stop while its gateway still has its place.
void check_lease(const std::map<std::string, std::string>& properties, std::chrono::milliseconds session_timeout);

/// When the registry last confirmed a gateway's place. Not thread safe.
class LeaseConfirmation {
 public:
  /// \param at when the gateway asked. An earlier one than before changes nothing. \return whether it is later.
  bool renew(config::Clock::Instant at);
  /// How much of the lease is left; zero: it has run out, or nothing was confirmed yet.
  std::chrono::nanoseconds left(std::chrono::milliseconds lease, config::Clock::Instant now) const;

 private:
  std::optional<config::Clock::Instant> latest_;
};

}  // namespace iotcloud::gateway
