#pragma once

#include <algorithm>
#include <chrono>

namespace iotcloud::processes {

/// Measures how long another process has been silent while this one was listening. If the listener itself stood still
/// (it was stopped, or the machine was busy), that time does not count as the other's silence.
class Silence {
 public:
  using Instant = std::chrono::steady_clock::time_point;

  /// \param longest_pause the longest time between two calls of measure(); longer pauses count as this long.
  Silence(Instant now, std::chrono::milliseconds longest_pause) : longest_pause_(longest_pause), last_measured_(now) {}

  void heard() { so_far_ = {}; }
  std::chrono::nanoseconds measure(Instant now) {
    so_far_ += std::min<std::chrono::nanoseconds>(now - last_measured_, longest_pause_);
    last_measured_ = now;
    return so_far_;
  }

 private:
  const std::chrono::nanoseconds longest_pause_;
  Instant last_measured_;
  std::chrono::nanoseconds so_far_{0};
};

}  // namespace iotcloud::processes
