#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>

#include <iotcloud/config/thread_safety.h>

namespace iotcloud::config {

class ConditionVariable;
class Mutex;

/// The one source of time, injected wherever a time-out, a period or a time stamp is needed, so that tests move time
/// instead of sleeping. Thread safe. Its users do not own it: it outlives them.
class Clock {
 public:
  using Instant = std::chrono::steady_clock::time_point;
  virtual ~Clock() = default;

  /// Monotonic time, for durations and time-outs.
  virtual Instant now() const = 0;
  /// Milliseconds since 1970-01-01 UTC, for time stamps that cross processes (docs/wire.md#message-metadata).
  virtual std::int64_t wall_ms() const = 0;

  /// Implements ConditionVariable::wait_until(). Returns when `changed` is notified, when this clock reaches `end`
  /// (timeout), or spuriously. This implementation waits on the steady clock for the time left until `end` on this
  /// clock. A clock that a test moves overrides it to return as soon as the test has moved the clock.
  virtual std::cv_status wait_until(ConditionVariable& changed, Mutex& mutex, Instant end) const
      IOTCLOUD_REQUIRES(mutex);
};

/// The machine's clock (one object for the process).
const Clock& system_clock();

}  // namespace iotcloud::config
