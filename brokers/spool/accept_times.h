#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <deque>

#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::spool {

/// Tells how old the records are that this publisher accepted, by the steady clock. A record itself has the time of day
/// at which its message was accepted, which a change of the time of day makes useless within this process. So this
/// class notes by how much the two clocks differ, and from which record on: one entry for each change. Its owner's
/// mutex guards it.
class AcceptTimes {
 public:
  /// Differences below this are not noted, because the two clocks are not read at the same instant, and NTP may slew
  /// the time of day.
  static constexpr std::chrono::milliseconds tolerance{100};

  /// Notes that record `sequence` was accepted now. Call it for each record, in order.
  void note(std::uint64_t sequence, config::Clock::Instant now, std::int64_t wall_ms) {
    const std::int64_t ahead_ms = wall_ms - steady_ms(now);
    if (changes_.empty() || std::abs(ahead_ms - changes_.back().ahead_ms) >= tolerance.count()) {
      changes_.push_back({sequence, ahead_ms});
    }
  }
  /// \param sequence a record that was noted. \param accepted_ms time of day at which it was accepted
  std::chrono::milliseconds age(std::uint64_t sequence, std::int64_t accepted_ms, config::Clock::Instant now) const {
    const auto change = std::find_if(changes_.rbegin(), changes_.rend(),
                                     [&](const Change& candidate) { return candidate.from <= sequence; });
    if (change == changes_.rend()) return {};
    const std::int64_t accepted_at = accepted_ms - change->ahead_ms;
    return std::chrono::milliseconds(std::max<std::int64_t>(steady_ms(now) - accepted_at, 0));
  }
  /// Forgets what only records below `sequence` need.
  void forget_below(std::uint64_t sequence) {
    while (changes_.size() > 1 && changes_[1].from <= sequence) changes_.pop_front();
  }

 private:
  struct Change {
    std::uint64_t from = 0;     ///< the first record that was accepted after the change
    std::int64_t ahead_ms = 0;  ///< the time of day minus the steady clock's time
  };
  static std::int64_t steady_ms(config::Clock::Instant instant) {
    return std::chrono::duration_cast<std::chrono::milliseconds>(instant.time_since_epoch()).count();
  }

  std::deque<Change> changes_;  ///< ascending
};

}  // namespace iotcloud::brokers::spool
