#pragma once

#include <chrono>
#include <cstdint>

#include "iotcloud/brokers/rabbitmq/wire/acknowledged_bytes.h"
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::rabbitmq {

/// Detects a stuck send: a server under a memory alarm may read nothing for ever, and the library has no time-out for
/// that. Not thread safe.
class StallWatch {
 public:
  using Instant = config::Clock::Instant;

  /// To be called periodically while a thread has the connection. \param turn PublishCore::turns() \return whether the
  /// thread has had the connection for `limit` while the peer's TCP acknowledged no byte
  bool stalls(std::uint64_t turn, int descriptor, Instant now, std::chrono::milliseconds limit) {
    if (turn != turn_) {
      turn_ = turn;
      since_ = now;
    }
    if (now - since_ < limit) return false;
    const auto acknowledged = acknowledged_bytes(descriptor);
    if (!acknowledged || *acknowledged == acknowledged_) return true;
    acknowledged_ = *acknowledged;  // slow, but not stuck
    since_ = now;
    return false;
  }

 private:
  std::uint64_t turn_ = 0;
  Instant since_{};                 ///< when that turn was first seen, or bytes were last acknowledged
  std::uint64_t acknowledged_ = 0;  ///< bytes acknowledged by the peer's TCP at the last look
};

}  // namespace iotcloud::brokers::rabbitmq
