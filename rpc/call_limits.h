#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <memory>
#include <string>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/security/tokens.h>

namespace iotcloud::rpc {

/// Limits the calls of each identity, at the same time (answers that the client has not taken yet included) and in a
/// second, so that one that asks without end does not keep others from a service. Each identity has limits of its own.
/// Thread safe.
class CallLimits {
 public:
  struct Options {
    int at_once = 16;
    double per_second = 100;
    /// After a pause the calls of so much time may come together.
    std::chrono::seconds saved{2};
    /// The longest time for which a call waits for its turn.
    std::chrono::milliseconds longest_wait{5'000};
  };
  explicit CallLimits(Options options, const config::Clock& clock = config::system_clock())
      : options_(options), clock_(clock) {}
  CallLimits() : CallLimits(Options()) {}

  /// Waits for the turn of a call. \return an object to hold until its answer was taken; null: its turn would come too
  /// late. May outlive this object.
  std::shared_ptr<void> enter(const std::string& identity);
  /// How many identities are remembered: those that have called lately, and as many or a thousand others.
  std::size_t remembered() const;

 private:
  /// The calls of one identity.
  struct Account {
    config::Mutex mutex;
    config::ConditionVariable changed;
    int running IOTCLOUD_GUARDED_BY(mutex) = 0;
    /// When the next call would be due if calls came evenly (the "generic cell rate algorithm", ITU-T I.371).
    config::Clock::Instant due IOTCLOUD_GUARDED_BY(mutex);
  };
  std::shared_ptr<Account> account(const std::string& identity) IOTCLOUD_EXCLUDES(mutex_);
  void forget_idle() IOTCLOUD_REQUIRES(mutex_);

  const Options options_;
  const config::Clock& clock_;
  mutable config::Mutex mutex_;
  std::map<std::string, std::shared_ptr<Account>> accounts_ IOTCLOUD_GUARDED_BY(mutex_);
  std::size_t forget_at_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< with so many accounts those that are idle go
};

/// The limits of each identity's calls, by its role.
using CallsByRole = std::map<security::Role, CallLimits::Options>;

/// How many tokens each caller, whoever it is, may try that take a hash (TokenKeeper::costs()). Such a hash takes some
/// ten milliseconds of all callers, so one that tries without end has no more than a tenth of them.
/// \param longest_wait how long a try waits for its turn
CallLimits::Options usual_token_tries(std::chrono::milliseconds longest_wait);

/// What holds unless a configuration says otherwise. Those who may act have ten times the calls of a viewer, which is
/// more than the command line makes with a manifest of thousands, a plugin's pieces, or a master for all its viewers.
CallsByRole usual_calls();

/// CallLimits for the identities of each role, and of strangers (Role::anyone). Thread safe.
class RoleLimits {
 public:
  explicit RoleLimits(const CallsByRole& calls = usual_calls());
  /// As CallLimits::enter(); a role that is not in the list is not limited.
  std::shared_ptr<void> enter(security::Role role, const std::string& identity);

 private:
  const std::shared_ptr<void> unlimited_ = std::make_shared<int>();  ///< is held by calls that nothing limits
  std::map<security::Role, CallLimits> limits_;
};

}  // namespace iotcloud::rpc
