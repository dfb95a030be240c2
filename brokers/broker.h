#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/brokers/message.h>
#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>

namespace iotcloud::brokers {

/// Where messages of a channel go. `name` is the wire name `gateway.driver[.instance].queue` (docs/wire.md#topics).
struct Topic {
  std::string exchange;  ///< RabbitMQ: the direct exchange the publisher declares. Others ignore it.
  std::string name;      ///< binding key, queue name prefix, Kafka topic
  bool durable = false;  ///< survives a restart of the server: durable exchange and queue, persistent messages
  friend bool operator==(const Topic&, const Topic&) = default;
  // clang-tidy 14 takes the zero that it compares with for a pointer: NOLINTNEXTLINE(modernize-use-nullptr)
  friend auto operator<=>(const Topic&, const Topic&) = default;
};

/// Answer of publish(): it never blocks and never throws.
enum class PublishStatus {
  accepted,     ///< the publisher has it; exactly one outcome follows
  would_block,  ///< the publisher is full (see PublisherOptions::when_full); on_writable follows
  closed,       ///< the publisher was closed
};

/// What publish() returns.
struct Published {
  PublishStatus status = PublishStatus::closed;
  /// Of an accepted message: 1, 2, 3, ... for each publisher. on_outcome names the message by it, and may do so before
  /// publish() has returned. Otherwise 0.
  std::uint64_t number = 0;
  friend bool operator==(const Published& published, PublishStatus other) { return published.status == other; }
};

/// The outcome of a message that was accepted.
enum class Outcome {
  confirmed,  ///< the broker has it
  refused,    ///< the broker will never take it: it is too large, or a header is
  dropped,    ///< by the channel's own policy: superseded (keep_newest), too old (deadline), see `reason`
  unknown,    ///< the publisher was closed before the broker answered
};

/// The policies for more messages than the broker takes (it is away, slow, or nobody reads the topic yet).
enum class WhenFull {
  keep_newest,  ///< drop the oldest that waits: for frames, where stale is worse than none
  block,        ///< answer would_block: for readings, where lost is worse than late
};

/// Priorities of channels. Messages carry their channel's priority where the broker knows priorities. Those of
/// `urgent_priority` and higher (control channels) also travel on connections of their own, so that they never wait
/// behind bulk data.
inline constexpr std::uint8_t normal_priority = 4;
inline constexpr std::uint8_t urgent_priority = 5;

/// How one publisher treats its messages. Copied when the publisher is made; the callbacks live as long as it does.
struct PublisherOptions {
  WhenFull when_full = WhenFull::block;
  std::size_t capacity = 1024;            ///< messages that may wait (not yet confirmed ones included)
  std::chrono::milliseconds deadline{0};  ///< older messages are worthless: dropped here, TTL at the broker. 0 = none
  /// Also makes the topic's own queue `<topic>`, where what is sent waits for a reader that may come much later (dead
  /// letters). Without a reader the queue of a topic that is not durable is gone after a minute.
  bool own_queue = false;
  /// RabbitMQ: the name of the own queue where programs of the original system read it: declared as they do, not
  /// durable, automatically deleted, without arguments. Empty: the topic's name, and declared for readers of this
  /// project.
  std::string original_queue;
  std::uint8_t priority = normal_priority;  ///< 0 to 9, see normal_priority
  /// The publisher drops ("fenced") a message that it accepted before this instant of the broker's clock and that it is
  /// still to send, or to send again: its sender may have lost the right to send it. The publisher calls this function
  /// before each attempt to send, on any thread, also inside publish(); it must not block. Empty: nothing is dropped
  /// for this reason.
  std::function<config::Clock::Instant()> void_before;
  /// Called once for each accepted message with its number (Published::number) and, for drops, the reason
  /// ("superseded", "deadline", "no_reader", "fenced", ...). From any thread, never from inside publish(). May be
  /// empty.
  std::function<void(std::uint64_t number, Outcome outcome, const std::string& reason)> on_outcome;
  /// Called after a would_block when there is room again. From any thread. May be empty.
  std::function<void()> on_writable;
};

/// The history of a message before this publisher gets it.
struct Past {
  bool possibly_sent = false;        ///< an earlier process may have sent it: the receiver sees `redelivered`
  std::chrono::milliseconds age{0};  ///< the deadline counts from so long ago
};

/// Sends to one topic, in order. Thread safe. What it has accepted it sends again after a reconnect until the broker
/// has confirmed it (duplicates are possible, loss is not, order is kept; of a killed RabbitMQ: rabbitmq/README.md).
class Publisher {
 public:
  virtual ~Publisher() = default;  ///< closes without draining
  /// Sends on the caller's thread when that cannot block, otherwise the connection's writer does, in order.
  virtual Published publish(Message message) = 0;
  /// publish() for a message with a past (from a spool). A broker that cannot carry the past sends it as a new one.
  virtual Published publish_again(Message message, const Past& past) {
    static_cast<void>(past);
    return publish(std::move(message));
  }
  /// Waits until everything accepted has an outcome. \return false when `limit` passed first.
  virtual bool drain(std::chrono::milliseconds limit) = 0;
  /// Accepted messages without an outcome.
  virtual std::size_t pending() const = 0;
  /// When the oldest of them was accepted, by the broker's clock; nullopt: there is none, or it is not known.
  virtual std::optional<config::Clock::Instant> oldest() const { return std::nullopt; }
};

/// A reader's answer to a message that it was handed.
enum class Settlement {
  accept,  ///< done with it
  retry,   ///< deliver it again, before what follows in the topic where the broker can
  reject,  ///< never deliver it again: dead letter, see SubscriptionOptions::dead_letter
};

/// Where a delivery is settled; implemented by each broker. Thread safe, never throws; a late call (after reconnect or
/// close) is ignored: the broker delivers the message again.
class Settler {
 public:
  virtual ~Settler() = default;
  /// \param tag of the delivery, which only the broker that made it understands.
  virtual void settle(std::uint64_t tag, Settlement settlement) noexcept = 0;
};

/// One received message and the duty to settle it (with manual acknowledgement). Move only; dropping it unsettled means
/// `retry`. Settle from any thread.
class Delivery {
 public:
  Delivery(Message received, bool possibly_redelivered, std::shared_ptr<Settler> settler, std::uint64_t tag)
      : message(std::move(received)), redelivered(possibly_redelivered), settler_(std::move(settler)), tag_(tag) {}
  Delivery(Delivery&&) noexcept = default;
  Delivery& operator=(Delivery&& other) noexcept {
    if (this != &other) {
      settle(Settlement::retry);
      message = std::move(other.message);
      redelivered = other.redelivered;
      tries = other.tries;
      settler_ = std::move(other.settler_);
      tag_ = other.tag_;
    }
    return *this;
  }
  ~Delivery() { settle(Settlement::retry); }

  /// Tells the broker what became of the message. Only the first call counts. Any thread.
  void settle(Settlement settlement) noexcept {
    if (auto settler = std::exchange(settler_, nullptr)) settler->settle(tag_, settlement);
  }

  Message message;
  bool redelivered = false;  ///< somebody may have been handed it before
  std::uint32_t tries = 1;   ///< how often this reader has been handed it, this time included

 private:
  std::shared_ptr<Settler> settler_;  ///< null: nothing to settle (automatic acknowledgement, or done)
  std::uint64_t tag_ = 0;
};

/// Called on the broker's reader thread, one delivery of a subscription at a time, in the topic's order. May run long:
/// another thread then keeps the connection alive. Must not throw (a throw is logged and counts as `retry`).
using Handler = std::function<void(Delivery)>;

/// How one subscription reads its topic. Copied when the subscription is made.
struct SubscriptionOptions {
  std::string group;  ///< who reads: the topology's name. Each group has its own queue `<topic>.<group>`.
                      ///< Empty: the topic's own queue `<topic>` (a driver's inbound channel, the original's way).
  /// RabbitMQ, with an empty group: as PublisherOptions::original_queue.
  std::string original_queue;
  bool exclusive = true;         ///< a second reader of the same queue gets nothing until this one is gone
  bool automatic_ack = false;    ///< a delivery counts as accepted when it is handed on; there is nothing to settle
  std::uint16_t prefetch = 100;  ///< unsettled deliveries under way at most
  std::size_t keep_last = 0;     ///< conflate: of what waits only the newest N are handed on. 0 = keep all
  std::uint8_t priority = normal_priority;  ///< see normal_priority
  /// A delivery that was handed on so often and is to be retried again is rejected instead. 0 = retried for ever.
  std::uint32_t max_tries = 0;
  /// The topic, durable and with a queue of its own, that rejected messages are moved to; the original is accepted when
  /// the broker has confirmed the letter. Empty: on Kafka `<topic>.dlq`; others drop what is rejected, unless the queue
  /// has a dead-letter exchange on the server.
  std::string dead_letter;
  /// Only for brokers that split topics (see Broker::watch_partitions): reads this partition alone, counted from 0, in
  /// a group of its own, `<group>#<partition>`; that of partition 0 is `<group>`. nullopt: all partitions of the topic
  /// that this reader gets its share of. Other brokers ignore it.
  std::optional<std::int32_t> partition{};
  /// The limit to which Subscription::raise_prefetch() may raise `prefetch`; 0: it stays as it is.
  std::uint16_t prefetch_limit = 0;
};

/// Reads one topic until destroyed. The destructor returns when no handler runs any more (unless called from the
/// handler itself); unsettled deliveries go back to the broker.
class Subscription {
 public:
  virtual ~Subscription() = default;
  /// pause() stops taking messages (back pressure), resume() goes on. Thread safe; both take effect after the handler
  /// that runs.
  virtual void pause() = 0;
  virtual void resume() = 0;
  /// Lets so many unsettled deliveries be under way from now on, if these are more than before. Thread safe, also
  /// inside the handler. \return false: the options (`prefetch_limit`) or the broker do not allow so many, and nothing
  /// changed.
  virtual bool raise_prefetch(std::uint16_t prefetch) = 0;
  /// True while this one is reading; false while disconnected or while another reader holds the queue exclusively.
  virtual bool active() const = 0;
  /// How many messages wait at the broker for this reader, as the server said last; those that were handed to this
  /// client do not count. The call asks the server anew, for the next call, and does not wait. nullopt: not connected,
  /// not told yet, or this kind of broker is not asked (ActiveMQ). Thread safe, also inside the handler.
  virtual std::optional<std::uint64_t> backlog() { return std::nullopt; }
};

/// Follows the number of a topic's partitions until destroyed. The destructor returns when the callback does not run
/// any more; not to be called from it.
class PartitionWatch {
 public:
  virtual ~PartitionWatch() = default;
};

/// How a broker's connection is. `blocked`: connected, but the server takes no messages now (a memory or disk alarm).
enum class ConnectionState { connecting, connected, blocked, closed };

/// "connected", "away", or "takes no messages" (an alarm of the server).
std::string to_string(ConnectionState state);

/// One broker (a server or a cluster of them behind `urls`). Connects by itself, with back-off and jitter, says once
/// that it cannot, and reconnects for ever. Thread safe. Publishers and subscriptions must die before it.
class Broker {
 public:
  virtual ~Broker() = default;
  /// Returns at once, also while the server is away. The caller owns the publisher. \throws config::Error for a topic
  /// or options that this kind of broker cannot have.
  virtual std::unique_ptr<Publisher> publisher(const Topic& topic, const PublisherOptions& options) = 0;
  /// Returns at once; the handler runs as soon as the server is there. The caller owns the subscription. \throws
  /// config::Error for a topic or options that this kind of broker cannot have.
  virtual std::unique_ptr<Subscription> subscribe(const Topic& topic, const SubscriptionOptions& options,
                                                  Handler handler) = 0;
  /// Follows into how many partitions a topic is split: messages with one driver's id are all in one of them.
  /// The function is called on a thread of the broker with the number, at least 1, as soon as the server says that it
  /// has the topic, and after each change. \return null: this kind of broker does not split topics.
  virtual std::unique_ptr<PartitionWatch> watch_partitions(const Topic& /*topic*/,
                                                           const std::function<void(int count)>& /*told*/) {
    return nullptr;
  }
  /// Nobody will read the topic in this group any more (SubscriptionOptions::group): the server is asked to remove the
  /// group's queue, which it does only while the queue has no reader and no message, unsettled ones included. Returns
  /// at once; the broker tries for 2 s, because a subscription that was just destroyed may still count as a reader. Its
  /// destructor waits for that. A server that is away is not asked. RabbitMQ (classic, durable queues) and the embedded
  /// broker do this; others leave it to the server.
  virtual void remove_queue(const Topic& /*topic*/, const std::string& /*group*/) {}
  /// The state of the connections together: that of the worst one.
  virtual ConnectionState state() const = 0;
  /// Why it is not connected, in words for people; empty: it is, or nothing is known. Thread safe.
  virtual std::string problem() const { return ""; }
  /// The preferred one of its URLs.
  virtual const std::string& url() const = 0;
};

/// How a connection is protected, for the schemes that end in "s" (amqps, kafkas, activemqs). Files in PEM form.
struct Tls {
  std::string ca_file;           ///< whom to trust; empty: the system's authorities
  std::string certificate_file;  ///< the client's own; empty: none
  std::string key_file;
  /// Servers whose certificates are on this list (lists of revocations, one for each authority) get no password; empty:
  /// no such list.
  std::string revoked_file{};
  friend bool operator==(const Tls&, const Tls&) = default;
};

/// How to reach a broker, and how this process connects to it.
struct BrokerOptions {
  /// The servers of one broker: the first is preferred; the others are used in turn while it is away.
  /// "embedded://NAME" (the in-process broker of that name), "amqp://user:password@host:port/vhost" (RabbitMQ, with TLS
  /// "amqps"), "kafka://host:port", "activemq://user:password@host:port".
  std::vector<std::string> urls;
  /// The user; takes precedence over the one in the URL.
  std::string user;
  /// Where the password is, read at each attempt to connect: a file (its first line) or an environment variable. Both
  /// empty: the URL's.
  std::string password_file;
  std::string password_variable;
  Tls tls;
  /// Settings that only one kind of broker knows; each kind's README names them. An unknown one is an error.
  std::map<std::string, std::string> properties;
  std::chrono::milliseconds heartbeat{4000};    ///< a peer that is silent for two to three of these is given up
  std::chrono::milliseconds rpc_timeout{5000};  ///< for connecting, and for each answer of the server
  const config::Clock* clock = nullptr;         ///< nullptr: the system's
  config::Metrics* metrics = nullptr;           ///< nullptr: the process's
  friend bool operator==(const BrokerOptions&, const BrokerOptions&) = default;
};

/// Makes the broker that the URLs' scheme names. Returns at once, connecting in the background.
/// \throws config::Error for a scheme that is none (the message lists those there are), URLs of several kinds, or one
/// that cannot be read.
std::unique_ptr<Broker> make_broker(const BrokerOptions& options);

/// The kind of broker that a URL's scheme names. \throws config::Error as make_broker().
std::string broker_kind(const std::string& url);

/// The kinds of broker that configuration may name ("embedded", "rabbitmq", ...).
const std::vector<std::string>& broker_kinds();

/// The URL without its password, for logs and messages.
std::string printable_url(const std::string& url);

}  // namespace iotcloud::brokers
