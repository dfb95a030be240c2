#pragma once

#include <chrono>
#include <cstdint>

namespace iotcloud::config {

/// The one source of time, injected wherever a time-out, a period or a time stamp is needed, so that tests move
/// time instead of sleeping. Thread safe. Not owned by those who use it: it outlives them.
class Clock {
 public:
  using Instant = std::chrono::steady_clock::time_point;
  virtual ~Clock() = default;

  /// Monotonic time, for durations and time-outs.
  virtual Instant now() const = 0;
  /// Milliseconds since 1970-01-01 UTC, for time stamps that cross processes (REFERENCE: header `time`).
  virtual std::int64_t wall_ms() const = 0;
};

/// The machine's clock (one object for the process).
const Clock& system_clock();

}  // namespace iotcloud::config
