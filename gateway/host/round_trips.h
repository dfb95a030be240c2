#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/carried_messages.h>

namespace iotcloud::gateway {

/// Times the answers to one instance's messages. An answer carries the time of the message that it answers
/// (docs/wire.md#message-metadata); of messages of one millisecond the oldest counts as answered first, and each only
/// once. A command that answers nothing but has the time of a message that is not answered yet counts as its answer.
/// Both times are of the host's clock. Thread safe.
class RoundTrips {
 public:
  /// Answers to older messages are not known as such.
  static constexpr std::chrono::seconds longest{60};
  static constexpr std::size_t most = 4096;

  /// The instance is about to send a message of that time.
  void sent(std::int64_t time_ms, config::Clock::Instant now);
  /// The message of that time that sent() told of last was not taken.
  void refused(std::int64_t time_ms);
  /// The instance is about to be handed a message of that time. \return since when the message that it answers is under
  /// way, as a duration; nullopt: it answers none of the latest
  std::optional<config::Clock::Instant::duration> came(std::int64_t time_ms, config::Clock::Instant now);

 private:
  struct Sent {
    std::int64_t time_ms;
    config::Clock::Instant at;
    bool answered;
  };
  static bool is_before(std::int64_t time_ms, const Sent& sent);

  config::Mutex mutex_;
  std::deque<Sent> sent_ IOTCLOUD_GUARDED_BY(mutex_);  ///< in the order of their times
};

/// Appends the round trips of a host as a histogram of Prometheus has them: a counter for each of a fixed list of upper
/// ends, of all that took no longer. Appends nothing when there was none. \param plugin the host's, a label
void append_round_trips(const config::Histogram& round_trips, const std::string& plugin,
                        std::vector<config::Sample>& samples);
/// The seconds since a host told its samples, which its gateway adds to them, with its name in the label `host`.
inline constexpr const char* samples_age_metric = "iotcloud_host_samples_age_seconds";
/// What the samples of driver hosts say, of each of those that have carried something.
std::vector<discovery::CarriedMessages> carried_messages(const std::vector<config::Sample>& samples);

}  // namespace iotcloud::gateway
