#pragma once

#include <algorithm>
#include <chrono>

namespace iotcloud::gateway {

/// How long a host has kept silent while somebody listened. A listener that stands still itself (a frozen gateway, a
/// busy machine) hears nothing, and what it slept too long is not the host's silence.
class Silence {
 public:
  using Instant = std::chrono::steady_clock::time_point;

  /// \param longest_pause between two looks; what is more in one does not count.
  Silence(Instant now, std::chrono::milliseconds longest_pause) : longest_pause_(longest_pause), last_look_(now) {}

  void heard() { so_far_ = {}; }
  std::chrono::nanoseconds look(Instant now) {
    so_far_ += std::min<std::chrono::nanoseconds>(now - last_look_, longest_pause_);
    last_look_ = now;
    return so_far_;
  }

 private:
  const std::chrono::nanoseconds longest_pause_;
  Instant last_look_;
  std::chrono::nanoseconds so_far_{0};
};

}  // namespace iotcloud::gateway
