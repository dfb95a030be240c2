#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>

#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::rabbitmq {

/// Detects a server that does not answer: the oldest message under way stays the same for too long. A new connection
/// may not help, so the time limit doubles each time, up to eight times the original one, and returns to that one a
/// minute after the last time. Not thread safe.
class AnswerWatch {
 public:
  using Instant = config::Clock::Instant;

  /// \param limit how long the oldest message may be without an answer
  explicit AnswerWatch(std::chrono::milliseconds limit) : limit_(limit) {}

  /// To be called while no message is under way or no answer is expected.
  void rest(Instant now) {
    oldest_.reset();
    if (now - gave_up_at_ > forgotten_after) gave_up_ = 0;
  }
  /// To be called periodically. \param oldest the number of the oldest message under way
  /// \return how long there was no answer, if that is too long; then the next call starts again
  std::optional<std::chrono::milliseconds> overdue(std::uint64_t oldest, Instant now) {
    if (oldest_ != oldest) {
      rest(now);
      oldest_ = oldest;
      since_ = now;
      return std::nullopt;
    }
    const std::chrono::milliseconds patience = limit_ * (1U << std::min(gave_up_, most_doublings));
    if (now - since_ < patience) return std::nullopt;
    oldest_.reset();
    ++gave_up_;
    gave_up_at_ = now;
    return patience;
  }

 private:
  static constexpr unsigned most_doublings = 3;
  static constexpr std::chrono::minutes forgotten_after{1};

  const std::chrono::milliseconds limit_;
  std::optional<std::uint64_t> oldest_;
  Instant since_{};       ///< since when oldest_ is the oldest message
  unsigned gave_up_ = 0;  ///< how often it was too long, with less than forgotten_after in between
  Instant gave_up_at_{};
};

}  // namespace iotcloud::brokers::rabbitmq
