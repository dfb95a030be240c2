#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "iotcloud/brokers/client/read_core.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/cluster.h"
#include "iotcloud/brokers/rabbitmq/connection_life.h"
#include "iotcloud/brokers/rabbitmq/queue_reader.h"
#include "iotcloud/brokers/rabbitmq/read_channels.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/wire/link_sleep.h"
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::rabbitmq {

using client::ReadCore;

/// A consuming connection of a broker object: the transport of a ReadCore, with one thread that reads the connection
/// and runs the handlers.
///
/// Each subscription has a channel of its own, because a refusal (another reader is exclusive) closes the channel. No
/// function waits for the server's answers: requests are sent one after the other, and answers are handled as they
/// arrive.
///
/// Threads: the *wire* (the AmqpLink) belongs to one thread at a time, the one that has a WireTurn. The core's mutex,
/// which users' threads lock to settle, is never held during I/O. Outgoing methods are gathered under the mutex and
/// written without it, as far as the socket takes them at once; the rest waits until the connection's thread finds the
/// socket writable. So a user's thread that settles or ends a subscription waits neither for the network nor for a
/// thread that does. If no other thread has the WireTurn, it writes itself, which saves waking the connection's thread
/// for each acknowledgement; otherwise the thread that has the WireTurn writes. While a handler runs long the broker's
/// keeper reads on (read_during_handler()), up to the prefetch, answers heartbeats, and sends settlements.
class ReadConnection final : client::ReadTransport,
                             ConnectionLife::Owner,
                             public std::enable_shared_from_this<ReadConnection> {
 public:
  /// \param purpose shown by RabbitMQ's tools. The other arguments outlive close().
  ReadConnection(const Cluster& cluster, const char* purpose, Meters& meters, const config::Clock& clock,
                 ConnectionLog& log);
  ~ReadConnection() override = default;
  ReadConnection(const ReadConnection&) = delete;
  ReadConnection& operator=(const ReadConnection&) = delete;
  /// Closes the connection and ends the thread, if there is one. Not to be called from a handler.
  void close();

  /// Adds a subscription. The first one starts the thread, which connects.
  std::shared_ptr<QueueReader> add(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  /// Ends a subscription; returns when its handler has returned, unless called from it.
  /// This and the next five functions do nothing and return false (raise_prefetch(): nullopt) if the subscription has
  /// moved to another connection: ask its connection().
  bool remove(const std::shared_ptr<QueueReader>& reader);
  bool pause(QueueReader& reader);
  bool resume(QueueReader& reader);
  /// \return whether its queue allows it.
  std::optional<bool> raise_prefetch(const std::shared_ptr<QueueReader>& reader, std::uint16_t prefetch);
  /// Asks the server how many messages the reader's queue has. \param last what the server said last; nullopt: nothing
  bool backlog(const std::shared_ptr<QueueReader>& reader, std::optional<std::uint64_t>& last);
  bool active(const QueueReader& reader) const;
  void settle(QueueReader& reader, std::uint64_t public_tag, Settlement settlement) noexcept;
  ConnectionState state() const;  ///< `connected` also when there is no subscription and so no connection
  /// The keeper calls this periodically: while a handler runs long, reads on and sends settlements.
  void read_during_handler();
  bool has_room() const;    ///< for one more subscription
  bool over_limit() const;  ///< it has more subscriptions than its server allows channels
  /// Moves subscriptions for which it has no channel to another connection, as many as that one takes. Only the keeper
  /// calls it, so that no other thread holds the mutexes of two connections.
  void share(ReadConnection& other);
  /// For the broker's keeper, which probes the preferred server.
  ConnectionLife& life() { return life_; }

 private:
  using Instant = config::Clock::Instant;

  /// Exclusive use of the wire as long as the object lives, even while the mutex is released. Construct and destroy it
  /// with the mutex held.
  class WireTurn {
   public:
    /// Waits until no other thread has the WireTurn.
    explicit WireTurn(ReadConnection& link) IOTCLOUD_REQUIRES(link.core_.mutex);
    ~WireTurn() IOTCLOUD_NO_THREAD_SAFETY_ANALYSIS;  // the mutex is held, see above
    WireTurn(const WireTurn&) = delete;
    WireTurn& operator=(const WireTurn&) = delete;

   private:
    ReadConnection& link_;
  };

  // The ReadTransport.
  void settled(client::DeliveryStream& stream, bool first) noexcept override IOTCLOUD_REQUIRES(core_.mutex);
  void wake() noexcept override IOTCLOUD_REQUIRES(core_.mutex);

  bool reads_here(const QueueReader& reader) const { return reader.connection().get() == this; }

  // The ConnectionLife's Owner.
  void open(std::size_t server) override IOTCLOUD_EXCLUDES(core_.mutex);
  std::shared_ptr<ShownChain> opened() override;
  void serve(ConnectionLife::Readiness ready) override;
  void call_back() override;
  ConnectionLife::Rest rest() override;
  bool idle() const override;
  void finish() override;
  void forget() override;
  void close(bool in_order) noexcept override IOTCLOUD_EXCLUDES(core_.mutex);

  // Run on the connection's thread.
  void hand_on() IOTCLOUD_REQUIRES(core_.mutex);
  void write_due() IOTCLOUD_REQUIRES(core_.mutex);
  std::chrono::milliseconds time_to_sleep() const IOTCLOUD_REQUIRES(core_.mutex);

  // These need the WireTurn and throw LinkError.
  void read_frames() IOTCLOUD_EXCLUDES(core_.mutex) IOTCLOUD_REQUIRES(wire_role_);
  void on_frame(const amqp_frame_t& frame) IOTCLOUD_EXCLUDES(core_.mutex) IOTCLOUD_REQUIRES(wire_role_);
  void on_method(const amqp_method_t& method, amqp_channel_t channel) IOTCLOUD_EXCLUDES(core_.mutex)
      IOTCLOUD_REQUIRES(wire_role_);
  void on_arrived(QueueReader& reader, Arrived arrived) IOTCLOUD_EXCLUDES(core_.mutex) IOTCLOUD_REQUIRES(wire_role_);
  void on_channel_closed(QueueReader* reader, const amqp_channel_close_t& why, amqp_channel_t channel)
      IOTCLOUD_REQUIRES(core_.mutex, wire_role_);
  bool handlers_wait() const IOTCLOUD_EXCLUDES(core_.mutex);
  void request(const std::shared_ptr<QueueReader>& reader) IOTCLOUD_REQUIRES(core_.mutex, wire_role_);
  void check_timers() IOTCLOUD_REQUIRES(core_.mutex, wire_role_);
  /// Turns settlements and ended subscriptions into outgoing methods.
  void gather() IOTCLOUD_REQUIRES(core_.mutex, wire_role_);
  /// Writes outgoing methods, with the mutex released, as far as the socket takes them at once.
  void write() IOTCLOUD_REQUIRES(core_.mutex, wire_role_);
  /// gather() and write(), repeated if other threads left something meanwhile.
  void write_all() IOTCLOUD_REQUIRES(core_.mutex, wire_role_);

  /// write_all() on a user's thread if no other thread has the WireTurn; otherwise that thread does it.
  void write_or_leave() noexcept IOTCLOUD_REQUIRES(core_.mutex);
  void set_timer(QueueReader& reader, Instant at) IOTCLOUD_REQUIRES(core_.mutex);
  void retry_later(QueueReader& reader) IOTCLOUD_REQUIRES(core_.mutex);
  /// The server has answered a request, so a waiting subscription may be requested.
  void answered() IOTCLOUD_REQUIRES(core_.mutex);

  const Cluster& cluster_;
  const char* const purpose_;
  Meters& meters_;
  const config::Clock& clock_;
  LinkSleep sleep_;  ///< only the connection's thread calls watch()
  ReadCore core_;

  // Used by the thread that has the WireTurn. The connection's thread sets it with the mutex, and takes it away with
  // the WireTurn and the mutex. Null while there is no connection.
  std::unique_ptr<AmqpLink> wire_;
  /// A connection that is not used yet, or not any more. Only the connection's thread uses it.
  std::unique_ptr<AmqpLink> spare_;
  config::ThreadRole wire_role_;  ///< the thread that has the WireTurn
  ReadChannels channels_ IOTCLOUD_GUARDED_BY(wire_role_);

  config::ConditionVariable wire_free_;
  bool wire_taken_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  /// Something is to be written; the thread that has the WireTurn, or the connection's thread, does it.
  bool left_for_wire_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  bool unwritten_ IOTCLOUD_GUARDED_BY(core_.mutex) =
      false;  ///< the socket took no more; some outgoing methods are left
  /// The AmqpLink holds received bytes, which poll() does not show.
  bool buffered_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;

  std::vector<std::shared_ptr<QueueReader>> readers_ IOTCLOUD_GUARDED_BY(core_.mutex);
  /// Removed subscriptions whose channels are not closed yet.
  std::vector<std::shared_ptr<QueueReader>> leaving_ IOTCLOUD_GUARDED_BY(core_.mutex);
  /// Subscriptions whose prefetch was raised, which the server was not told yet.
  std::vector<std::shared_ptr<QueueReader>> raised_ IOTCLOUD_GUARDED_BY(core_.mutex);
  /// Subscriptions for whose queues the server is to be asked how many messages they have.
  std::vector<std::shared_ptr<QueueReader>> asking_ IOTCLOUD_GUARDED_BY(core_.mutex);
  /// No reader's retry_at is earlier, except those of readers for which openers_wait_ is set.
  std::optional<Instant> next_timer_ IOTCLOUD_GUARDED_BY(core_.mutex);
  /// Some subscriptions are due, but wait until the server has answered earlier requests.
  bool openers_wait_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;

  /// The number of channels that we request; once connected, the number that the server allows.
  std::size_t channel_limit_ IOTCLOUD_GUARDED_BY(core_.mutex);

  ConnectionLife life_;
};

}  // namespace iotcloud::brokers::rabbitmq
