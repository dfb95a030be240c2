#pragma once

#include <chrono>
#include <cstdint>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>

namespace iotcloud::topology::storm {

/// Measures how long calls take: each call while they are seldom, and one in `most` of those that follow each other
/// closely, because two looks at the clock cost as much as the rest of a tuple's way to C++. A measured call also
/// stands in the histogram for those before it that were not. One call at a time.
class CallTimer {
 public:
  static constexpr std::uint64_t most = 16;
  static constexpr std::chrono::microseconds closely{20};

  /// \param clock, histogram live as long.
  CallTimer(const config::Clock& clock, config::Histogram& histogram) : clock_(clock), histogram_(histogram) {}

  /// \throws what the call throws, whose time is not noted then.
  template <typename Call>
  void time(Call&& call) {
    if (++calls_ < every_) return call();
    const auto began = clock_.now();
    every_ = began - last_ < calls_ * closely ? most : 1;
    last_ = began;
    call();
    histogram_.record_ns(std::chrono::nanoseconds(clock_.now() - began).count(), calls_);
    calls_ = 0;
  }

 private:
  const config::Clock& clock_;
  config::Histogram& histogram_;
  config::Clock::Instant last_{};
  std::uint64_t calls_ = 0;  ///< since the last one that was measured
  std::uint64_t every_ = 1;
};

}  // namespace iotcloud::topology::storm
