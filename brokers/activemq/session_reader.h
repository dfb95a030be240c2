#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include <proton/types.h>

#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/client/read_transport.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::activemq {

class ReceiverLink;

/// One subscription as its connection sees it. Guarded by the link's mutex, except for the constants.
class SessionReader final : public client::OwnDeliveryStream {
 public:
  enum class Phase {
    idle,     ///< no session: not connected, or waiting for `retry_at`
    asking,   ///< no session: it has asked whether another reader has the queue, at `asked_at`
    opening,  ///< requested at `asked_at`
    active,   ///< reads
  };

  SessionReader(std::shared_ptr<ReceiverLink> link, std::string name, Topic topic, SubscriptionOptions options,
                Handler handler);
  void settle(std::uint64_t tag, Settlement settlement) noexcept override;

  const std::string name;  ///< the name of its AMQP link, unique on the connection
  const std::string queue;

  Phase phase = Phase::idle;
  std::optional<config::Clock::Instant> retry_at;  ///< while an answer is awaited: when to see whether it is overdue
  config::Clock::Instant asked_at{};
  client::Backoff backoff{std::chrono::milliseconds(50), std::chrono::milliseconds(1000)};
  std::string complaint;     ///< the last logged complaint, so that it is not logged again
  bool odd_logged = false;   ///< an undecodable message was logged
  bool read_before = false;  ///< this reader has been active before, on any session
  bool stands_by = false;    ///< another reader had the queue when it last looked
  /// How many of the next messages may have been handed on before although the server does not mark them: a killed
  /// server forgets what it had delivered. After a reconnection, all messages that wait in the queue count as such.
  std::uint64_t doubtful = 0;

  pn_session_t* session = nullptr;
  pn_link_t* receiver = nullptr;
  std::uint32_t owed = 0;  ///< used credit that was not renewed at the server yet
  /// The server's deliveries from tag `first_held` on; null: settled before an earlier one.
  std::deque<pn_delivery_t*> held;
  std::uint64_t first_held = 1;

 private:
  const std::shared_ptr<ReceiverLink> link_;
};

}  // namespace iotcloud::brokers::activemq
