#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

#include "iotcloud/brokers/client/outbox.h"

namespace iotcloud::brokers::client {

/// Tracks the earliest timer of many publishers without asking all of them each time, because a connection may have
/// thousands. Guarded by the connection's mutex.
class OutboxTimers {
 public:
  using Instant = config::Clock::Instant;

  /// Call it after every change of a publisher's messages. \return true if its timer is now the earliest, so that a
  /// thread that sleeps until the previous next() must be woken.
  bool note(const Outbox& outbox) {
    const std::optional<Instant> timer = outbox.next_timer();
    if (!timer || *timer >= next_) return false;
    next_ = *timer;
    return true;
  }
  /// No publisher has an earlier timer. The timer may belong to a message that was sent meanwhile.
  Instant next() const { return next_; }
  /// Fires the timers that are due and calls `fired` with each of their publishers. Does nothing before next().
  /// \param outboxes all publishers of the connection (shared_ptr)
  template <typename Outboxes, typename Fired>
  void fire(const Outboxes& outboxes, Instant now, Fired fired) {
    if (now < next_) return;
    next_ = Instant::max();
    for (const auto& outbox : outboxes) {
      const std::optional<Instant> timer = outbox->next_timer();
      if (!timer) continue;
      if (*timer <= now) {
        outbox->fire_timer(now);
        fired(outbox);
      }
      note(*outbox);
    }
  }

 private:
  Instant next_ = Instant::max();
};

}  // namespace iotcloud::brokers::client
