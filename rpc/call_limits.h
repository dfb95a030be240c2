#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <string>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::rpc {

/// Limits the calls of each identity, at the same time (answers that the client has not taken yet included) and in a
/// second, so that one that asks without end does not keep others from a service. Each identity has limits of its own.
/// Thread safe.
class CallLimits {
 public:
  struct Options {
    int at_once = 16;
    double per_second = 100;
    double burst = 200;  ///< so many may come together after a pause
    /// The longest time for which a call waits for its turn.
    std::chrono::milliseconds longest_wait{5'000};
  };
  explicit CallLimits(Options options, const config::Clock& clock = config::system_clock())
      : options_(options), clock_(clock) {}
  CallLimits() : CallLimits(Options()) {}

  /// Waits for the turn of a call. \return an object to hold until its answer was taken; null: its turn would come too
  /// late. May outlive this object.
  std::shared_ptr<void> enter(const std::string& identity);

 private:
  /// Of one identity.
  struct Account {
    config::Mutex mutex;
    config::ConditionVariable changed;
    int running IOTCLOUD_GUARDED_BY(mutex) = 0;
    /// When the next call would be due if calls came evenly (the "generic cell rate algorithm", ITU-T I.371).
    config::Clock::Instant due IOTCLOUD_GUARDED_BY(mutex);
  };
  std::shared_ptr<Account> account(const std::string& identity) IOTCLOUD_EXCLUDES(mutex_);

  const Options options_;
  const config::Clock& clock_;
  config::Mutex mutex_;
  std::map<std::string, std::shared_ptr<Account>> accounts_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::rpc
