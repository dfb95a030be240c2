#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/client/burst.h"
#include "iotcloud/brokers/client/publish_core.h"
#include "iotcloud/brokers/meters.h"
#include "iotcloud/brokers/rabbitmq/answer_watch.h"
#include "iotcloud/brokers/rabbitmq/cluster.h"
#include "iotcloud/brokers/rabbitmq/connection_life.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/wire/headers.h"
#include "iotcloud/brokers/rabbitmq/wire/link_sleep.h"
#include "iotcloud/brokers/rabbitmq/wire/stall_watch.h"

namespace iotcloud::brokers::rabbitmq {

using client::Outbox;
using client::PublishCore;
using client::UnderWay;

/// A publishing connection of a broker object: the transport of a PublishCore. All messages go over one AMQP channel
/// with publisher confirms.
///
/// Threads: callers of publish(), and the channel's own thread. The *wire* (the AmqpLink) belongs to one thread at a
/// time, the one that has the core's Turn; the core's mutex is never held during I/O. A caller sends on its own thread
/// if the socket's buffer has room; the channel's thread does everything else (answers, heartbeats, waiting messages,
/// connecting).
class PublishChannel final : client::PublishTransport, ConnectionLife::Owner {
 public:
  /// \param purpose shown by RabbitMQ's tools. The other arguments outlive this object.
  PublishChannel(const Cluster& cluster, const char* purpose, Meters& meters, const config::Clock& clock,
                 ConnectionLog& log);
  ~PublishChannel() override;
  PublishChannel(const PublishChannel&) = delete;
  PublishChannel& operator=(const PublishChannel&) = delete;

  /// The core, to which publishers are added.
  PublishCore& core() { return core_; }
  ConnectionState state() const;
  /// The broker's keeper calls this periodically: breaks a connection on which a send is stuck for too long.
  void watch();
  /// For the broker's keeper, which probes the preferred server.
  ConnectionLife& life() { return life_; }

 private:
  using Instant = config::Clock::Instant;

  // The PublishTransport.
  void added(const std::shared_ptr<Outbox>& outbox) override IOTCLOUD_REQUIRES(core_.mutex);
  Room room(const std::shared_ptr<Outbox>& outbox, const Message& next, bool alone) override
      IOTCLOUD_REQUIRES(core_.mutex);
  void send(UnderWay& message) override IOTCLOUD_REQUIRES(core_.mutex);
  void send_alone(UnderWay& message) override IOTCLOUD_REQUIRES(core_.mutex);
  void send_gathered() override IOTCLOUD_REQUIRES(core_.mutex);
  void broke(const char* why) noexcept override IOTCLOUD_REQUIRES(core_.mutex);
  void left_waiting(const std::shared_ptr<Outbox>& outbox, Instant now) override IOTCLOUD_REQUIRES(core_.mutex);
  void want_answers() override IOTCLOUD_REQUIRES(core_.mutex);
  void wake() noexcept override IOTCLOUD_REQUIRES(core_.mutex);

  // The ConnectionLife's Owner.
  void open(std::size_t server) override IOTCLOUD_EXCLUDES(core_.mutex);
  std::shared_ptr<ShownChain> opened() override;
  void serve(ConnectionLife::Readiness ready) override;
  void call_back() override;
  ConnectionLife::Rest rest() override;
  bool idle() const override;
  void finish() override {}  // what was sent is answered, or is sent again
  void forget() override;
  void close(bool in_order) noexcept override IOTCLOUD_EXCLUDES(core_.mutex);

  std::chrono::milliseconds time_to_sleep() IOTCLOUD_REQUIRES(core_.mutex);
  /// Ends a connection on which the oldest message has been unanswered for too long.
  void check_answers() IOTCLOUD_REQUIRES(core_.mutex);
  void declare_topics() IOTCLOUD_REQUIRES(core_.mutex);
  /// The server has forgotten the channel: makes messages under way wait again. \param one_by_one as in
  /// PublishCore::connection_lost()
  void forget_channel(bool one_by_one) IOTCLOUD_REQUIRES(core_.mutex);

  // Handle what the server sends. These need the core's Turn.
  void read_frames() IOTCLOUD_EXCLUDES(core_.mutex);
  void on_method(const amqp_method_t& method, amqp_channel_t channel);
  void on_returned(const amqp_basic_properties_t& properties);
  void on_answer(std::uint64_t tag, bool multiple, bool good);
  void on_channel_closed(const amqp_channel_close_t& closed);
  void answered(UnderWay& message, bool good) IOTCLOUD_REQUIRES(core_.mutex);

  /// Encodes a message and gathers it on the wire.
  void put(const UnderWay& message, Instant now) IOTCLOUD_EXCLUDES(core_.mutex);
  void give_tag(UnderWay& message) IOTCLOUD_REQUIRES(core_.mutex);
  /// Sends bytes that were held back for the rest of a burst.
  void push() IOTCLOUD_REQUIRES(core_.mutex);

  /// How long answers that nobody waits for may gather before they are read.
  static constexpr std::chrono::milliseconds gathering_time{2};
  static constexpr std::size_t most_gathered = 256;  ///< the most answers that may gather so

  const Cluster& cluster_;
  const char* const purpose_;
  const config::Clock& clock_;
  LinkSleep sleep_;  ///< watch() and put_off() need the mutex
  PublishCore core_;

  // Used by the thread that has the core's Turn. The channel's thread sets it with the mutex, and takes it away with
  // the Turn and the mutex. Null while there is no connection.
  std::unique_ptr<AmqpLink> wire_;
  /// A connection that is not used yet, or not any more. Only the channel's thread uses it.
  std::unique_ptr<AmqpLink> spare_;
  MessageProperties properties_;
  bool reading_return_ = false;  ///< the next header frame is that of a returned message

  /// The server asked us to publish nothing (memory or disk alarm).
  bool blocked_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  /// Poll reported room, so one message can be sent without asking again.
  bool writable_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  /// Somebody waits for answers to messages under way. Otherwise the channel's thread lets answers gather before it
  /// reads them, because waking it for each would cost more than sending the message.
  bool answers_wanted_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  /// The kernel may hold back the last sent bytes, because a burst goes on.
  bool held_back_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  std::vector<std::shared_ptr<Outbox>> undeclared_ IOTCLOUD_GUARDED_BY(core_.mutex);
  /// The exchanges declared on this connection, with whether they are durable.
  std::set<std::pair<std::string, bool>> declared_ IOTCLOUD_GUARDED_BY(core_.mutex);
  /// The sent messages by ascending delivery tag; null: answered.
  std::deque<UnderWay*> tags_ IOTCLOUD_GUARDED_BY(core_.mutex);
  std::uint64_t first_tag_ IOTCLOUD_GUARDED_BY(core_.mutex) = 1;  ///< of tags_.front()
  StallWatch stalls_ IOTCLOUD_GUARDED_BY(core_.mutex);
  AnswerWatch answers_ IOTCLOUD_GUARDED_BY(core_.mutex);
  /// This connection probably knows only the dead leader of some quorum queue: reconnect.
  bool stale_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  Instant next_renewal_ IOTCLOUD_GUARDED_BY(core_.mutex){};
  client::Backoff renewals_ IOTCLOUD_GUARDED_BY(core_.mutex){std::chrono::milliseconds(1000),
                                                             std::chrono::milliseconds(30'000)};

  const std::shared_ptr<client::Burst::Target> burst_target_;
  ConnectionLife life_;
};

}  // namespace iotcloud::brokers::rabbitmq
