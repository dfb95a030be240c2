#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>

#include "iotcloud/brokers/client/ack_window.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::client {

/// A subscription as its core sees it. Guarded by the core's mutex, except for the constants.
struct Subscriber {
  Subscriber(Topic to, SubscriptionOptions how, Handler what)
      : topic(std::move(to)), options(std::move(how)), handler(std::move(what)), prefetch(options.prefetch) {}

  const Topic topic;
  const SubscriptionOptions options;
  const Handler handler;
  std::uint16_t prefetch;  ///< Subscription::raise_prefetch() raises it
  bool paused = false;
  bool closed = false;
  bool running = false;  ///< its handler runs
};

/// A stream of messages that are handed on in order, to one subscription at a time: those of a RabbitMQ channel, an
/// ActiveMQ session or a Kafka partition. It is the Settler of its deliveries. Guarded by the core's mutex.
class DeliveryStream : public Settler, public std::enable_shared_from_this<DeliveryStream> {
 public:
  /// \param own_window lives as long as the stream
  DeliveryStream(std::shared_ptr<Subscriber> reader, AckWindow& own_window)
      : subscriber(std::move(reader)), window(own_window) {}
  DeliveryStream(const DeliveryStream&) = delete;
  DeliveryStream& operator=(const DeliveryStream&) = delete;

  std::shared_ptr<Subscriber> subscriber;  ///< the subscription that reads it now; null: none
  AckWindow& window;
  /// Counts lost channels and partitions, so that late settlements of earlier deliveries are recognized.
  std::uint64_t generation = 0;
  bool withheld = false;  ///< nothing of this stream is handed on for now
  bool more = false;      ///< the transport may have more for it: see ReadTransport::fetch()
  bool running = false;   ///< a handler runs with a message of it
  bool in_ready = false;  ///< listed in the core's ready_
  bool in_dirty = false;  ///< listed in the core's dirty_

  bool has_work() const {
    if (withheld || !subscriber || subscriber->closed) return false;
    return (window.waiting() > 0 && !subscriber->paused) || more;
  }
  /// The most settlements that may wait to be sent together. More are sent at once, because unsent settlements use up
  /// the prefetch.
  std::size_t patience() const { return subscriber->options.prefetch / 2U; }
  /// The tag in the user's Delivery: unique over all generations.
  std::uint64_t public_tag(std::uint64_t tag) const { return generation << 48U | tag; }
  /// The channel, session or partition is gone, and the server delivers again what was not settled: forgets all
  /// messages.
  void begin_anew() {
    ++generation;
    window.clear();
  }
  /// Makes unsettled messages that were handed on wait again, and voids later settlements of them.
  void take_back() {
    ++generation;
    window.return_all();
  }
};

/// A base class, so that the window is constructed before the stream that refers to it.
struct OwnWindow {
  AckWindow own_window;
};

/// A subscription that has one stream of its own for its whole life.
class OwnDeliveryStream : public Subscriber, OwnWindow, public DeliveryStream {
 protected:
  OwnDeliveryStream(Topic to, SubscriptionOptions how, Handler what)
      : Subscriber(std::move(to), std::move(how), std::move(what)),
        // A non-owning pointer to itself.
        DeliveryStream(std::shared_ptr<Subscriber>(std::shared_ptr<void>(), this), own_window) {}
};

/// One connection to one kind of broker, which a ReadCore uses. The transport asks the server for messages, passes
/// received ones to the core (ReadCore::arrived()) and tells the server the settlements (ReadCore::take_dirty()). The
/// core decides what is handed on when, and what a settlement means.
///
/// The core calls all these functions with its mutex held. It calls settled() and wake() on any thread, users' threads
/// included, so they must not wait for the network.
class ReadTransport {
 public:
  virtual ~ReadTransport() = default;

  /// One more message of this stream is settled, and the server may be told. On threads other than the one that hands
  /// on, the function may release the mutex. \param first whether it is the first settlement since the server was last
  /// told
  virtual void settled(DeliveryStream& stream, bool first) noexcept = 0;
  /// Wakes the thread that hands on, because there is a message to hand on.
  virtual void wake() noexcept = 0;
  /// Moves received messages into a stream that has DeliveryStream::more set, as long as it has room. Called on the
  /// thread that hands on, before each message of the stream. \return whether the stream has room for more
  virtual bool fetch(DeliveryStream& /*stream*/) { return false; }
};

}  // namespace iotcloud::brokers::client
