#pragma once

#include <chrono>
#include <optional>

#include <iotcloud/config/clock.h>

namespace iotcloud::processes {

/// When something that failed is started again. The pause before the restart doubles with each failure, and starts
/// again from `first` after it has run for `healthy_after`. After `give_up_after` failures in a row it is left alone.
struct RestartPolicy {
  std::chrono::milliseconds first{500};
  std::chrono::milliseconds longest{30000};
  std::chrono::milliseconds healthy_after{60000};
  int give_up_after = 8;  ///< 0: never
};

/// The pause that follows on `last`; 0: there was none.
std::chrono::milliseconds next_pause(std::chrono::milliseconds last, const RestartPolicy& policy);

/// Counts the failures of one thing in a row. Used on one thread.
class Restarts {
 public:
  using Instant = config::Clock::Instant;

  void started(Instant now) { started_ = now; }
  /// It has failed. \return the pause until it is to be started again; nullopt: it is to be left alone.
  std::optional<std::chrono::milliseconds> failed(Instant now, const RestartPolicy& policy);
  int failures() const { return failures_; }  ///< in a row

 private:
  Instant started_{};
  int failures_ = 0;
  std::chrono::milliseconds pause_{0};
};

}  // namespace iotcloud::processes
