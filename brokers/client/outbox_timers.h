#pragma once

#include <algorithm>
#include <chrono>
#include <optional>

#include "iotcloud/brokers/client/outbox.h"

namespace iotcloud::brokers::client {

/// When the earliest of many publishers' timers is due, without asking all of them each time: a connection may have
/// thousands. Guarded by the connection's mutex.
class OutboxTimers {
 public:
  using Instant = config::Clock::Instant;

  /// To be told of every change of a publisher's messages. \return whether its timer is the earliest of all now, so
  /// that who sleeps until next() sleeps for too long.
  bool note(const Outbox& outbox) {
    const std::optional<Instant> timer = outbox.next_timer();
    if (!timer || *timer >= next_) return false;
    next_ = *timer;
    return true;
  }
  /// No publisher has a timer before that; it may be a message's that has been sent since.
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
