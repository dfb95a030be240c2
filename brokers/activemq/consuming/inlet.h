#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include <proton/types.h>

#include "iotcloud/brokers/client/ack_window.h"
#include "iotcloud/brokers/client/backoff.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::activemq {

class ConsumeLink;

/// One subscription as its connection sees it. Guarded by the link's mutex, constants apart.
class Inlet final : public Settler, public std::enable_shared_from_this<Inlet> {
 public:
  enum class Phase {
    idle,     ///< no session: not connected, or waiting for `retry_at`
    opening,  ///< asked for; the answer is due until `retry_at`
    active,   ///< reads
  };

  Inlet(std::shared_ptr<ConsumeLink> link, std::string name, Topic topic, SubscriptionOptions options, Handler handler);
  void settle(std::uint64_t tag, Settlement settlement) noexcept override;

  const std::string name;  ///< of its link, unique on the connection
  const Topic topic;
  const SubscriptionOptions options;
  const Handler handler;
  const std::string queue;

  Phase phase = Phase::idle;
  std::optional<config::Clock::Instant> retry_at;
  client::Backoff backoff{std::chrono::milliseconds(50), std::chrono::milliseconds(1000)};
  std::uint64_t generation = 0;  ///< counts sessions, so that late settlements of an earlier one are known as such
  std::string complaint;         ///< the last that was logged, so that it is logged once
  client::AckWindow window;
  bool odd_logged = false;   ///< a message that cannot be carried was logged
  bool read_before = false;  ///< was active once, on whatever session
  /// Messages to come that may have been handed on already although the server does not say so: a server that was
  /// killed forgets what it had delivered. What waits in the queue when we come back is counted as such.
  std::uint64_t doubtful = 0;
  bool paused = false;
  bool closed = false;
  bool running = false;   ///< its handler runs
  bool in_ready = false;  ///< stands in the link's list of those with something to hand on
  bool in_dirty = false;  ///< stands in the link's list of those with settlements to send

  pn_session_t* session = nullptr;
  pn_link_t* receiver = nullptr;
  std::uint32_t owed = 0;  ///< credit that the server has not been given back yet
  /// The server's deliveries from tag `first_held` on; null: settled out of turn.
  std::deque<pn_delivery_t*> held;
  std::uint64_t first_held = 1;

  bool has_work() const { return window.waiting() > 0 && !paused && !closed; }
  /// What the user's Delivery carries: the tag, made unique over all sessions of this subscription.
  std::uint64_t public_tag(std::uint64_t tag) const { return generation << 48U | tag; }

 private:
  const std::shared_ptr<ConsumeLink> link_;
};

}  // namespace iotcloud::brokers::activemq
