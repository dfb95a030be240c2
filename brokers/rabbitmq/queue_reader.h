#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include <amqp.h>

#include "iotcloud/brokers/client/ack_window.h"
#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/client/read_transport.h"
#include "iotcloud/brokers/rabbitmq/resent_marks.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/wire/declarations.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::rabbitmq {

using client::Arrived;
using client::Backoff;

class ReadConnection;

/// Assembles the frames of one delivery: its method, its header, the pieces of its body. Copies the body once.
class Assembly {
 public:
  void begin(const amqp_basic_deliver_t& deliver);
  /// Both return the message when it is complete. \throws LinkError if the frames are inconsistent.
  std::optional<Arrived> header(const amqp_frame_t& frame, ResentMarks& resent);
  std::optional<Arrived> body(amqp_bytes_t piece);
  /// Whether the current delivery, or the one returned last, has more headers than allowed. They were not read, and no
  /// handler should get the message.
  bool too_many_headers() const { return too_many_headers_; }
  void reset() { *this = Assembly(); }

 private:
  std::optional<Arrived> finish();

  Arrived arrived_;
  bool expects_header_ = false;
  bool too_many_headers_ = false;
  std::shared_ptr<std::byte[]> bytes_;
  std::size_t size_ = 0;
  std::size_t filled_ = 0;
};

/// One subscription as its connection sees it. Guarded by the mutex of its connection, except for the constants. The
/// members of its channel are changed only by the thread that holds that mutex and has the connection's WireTurn, so a
/// thread with the WireTurn may read them without the mutex.
class QueueReader final : public client::OwnDeliveryStream {
 public:
  enum class Phase {
    idle,     ///< no channel: not connected, or waiting for `retry_at`
    opening,  ///< requested; the answer must come by `retry_at`
    active,   ///< reads
  };

  /// \param of_durable the type of durable topics' queues
  QueueReader(std::shared_ptr<ReadConnection> link, QueueType of_durable, Topic to, SubscriptionOptions how,
              Handler what);
  void settle(std::uint64_t tag, Settlement settlement) noexcept override;
  /// The connection through which it reads. It moves to another one if the server has no channel left for it. Thread
  /// safe.
  std::shared_ptr<ReadConnection> connection() const IOTCLOUD_EXCLUDES(connection_mutex_);
  /// To be called with the mutexes of both connections held.
  void move_to(std::shared_ptr<ReadConnection> link) IOTCLOUD_EXCLUDES(connection_mutex_);

  const std::string queue;
  const QueueType type;  ///< the queue's type, unless the queue is used as it is (`passive_queue`)

  Phase phase = Phase::idle;
  std::optional<config::Clock::Instant> retry_at;
  Backoff backoff{std::chrono::milliseconds(100), std::chrono::milliseconds(2000)};
  std::string complaint;     ///< the last logged complaint, so that it is not logged again
  bool read_before = false;  ///< this reader has been active before, on any channel
  /// How many of the next messages may have been handed on before although the server does not mark them: a killed
  /// server forgets what it had delivered. After a reconnection, all messages that wait in the queue count as such.
  std::uint32_t doubtful = 0;
  std::optional<std::uint64_t> backlog;  ///< how many messages the queue had when the server was asked last
  bool asks = false;                     ///< the server is asked now
  bool quick = false;                    ///< whether its handler was quick when it was last measured

  // Members of its channel.
  amqp_channel_t channel = 0;
  bool passive_exchange = false;  ///< the exchange exists with other properties: use it as it is
  bool passive_queue = false;
  // Used by the thread that has the WireTurn, without the mutex.
  Assembly assembly;
  ResentMarks resent;

  /// Whether its prefetch can be raised. RabbitMQ lets a client change the limit of a channel (qos with `global`) and
  /// not that of a consumer, and its quorum queues know no limit of a channel. A queue that is used as it is may be
  /// one.
  bool may_raise() const {
    return options.prefetch_limit > options.prefetch && type == QueueType::classic && !passive_queue;
  }
  /// Requests the channel, the queue and its messages; only the last answer, consume-ok, matters. \param on the
  /// channel's number. \param now its prefetch. \throws LinkError
  void request(AmqpLink& wire, amqp_channel_t on, std::uint16_t now) const;
  /// Asks how many messages its queue has. \pre active. \throws LinkError
  void ask(AmqpLink& wire, amqp_channel_t on) const;
  /// Sets the limit of its channel. \pre may_raise(). \throws LinkError
  static void limit_channel(AmqpLink& wire, amqp_channel_t on, std::uint16_t now);
  /// The server has answered consume-ok: reading begins.
  void reading_began();
  /// The server closed the channel: logs the reason once, and adapts the next request to it.
  void refused(const amqp_channel_close_t& answer);
  void forget_channel();

 private:
  mutable config::Mutex connection_mutex_;
  std::shared_ptr<ReadConnection> connection_ IOTCLOUD_GUARDED_BY(connection_mutex_);
};

}  // namespace iotcloud::brokers::rabbitmq
