#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <stop_token>

#include <iotcloud/recording/recording.h>

namespace iotcloud::recording {

/// When each message of a recording is due, at another pace than its own if one wants.
class Pace {
 public:
  using Clock = std::chrono::steady_clock;
  /// \param speed 2: twice as fast; 0: all at once.
  Pace(Instant first, Clock::time_point begin, double speed) : first_(first), begin_(begin), speed_(speed) {}
  Clock::time_point due(Instant at) const {
    if (speed_ <= 0 || at <= first_) return begin_;
    const double ns = static_cast<double>((at - first_).count()) / speed_;
    constexpr double far = 9e18;  // what the clock can hold
    return begin_ +
           std::chrono::duration_cast<Clock::duration>(Instant(static_cast<Instant::rep>(ns < far ? ns : far)));
  }

 private:
  Instant first_;
  Clock::time_point begin_;
  double speed_;
};

/// What a play has done.
struct Played {
  std::uint64_t messages = 0;
  std::chrono::nanoseconds latest{0};  ///< how late the latest message was handed over
};

/// Plays a recording on the caller's thread: hands over each message that `chosen` wants when it is due, in order,
/// until the end or until `stop` is requested. `hand` may wait: later messages are late then, and none is left out.
/// \throws RecordingError, and what `hand` throws.
Played play(RecordingReader& recording, double speed, const std::function<bool(const RecordedMessage&)>& chosen,
            const std::function<void(RecordedMessage)>& hand, const std::stop_token& stop);

}  // namespace iotcloud::recording
