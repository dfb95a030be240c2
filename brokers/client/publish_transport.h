#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <list>
#include <memory>

#include "iotcloud/brokers/client/outbox.h"
#include "iotcloud/brokers/envelope.h"
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::client {

/// A queue of publishers that share a resource of the transport: those that have something to send take turns. RabbitMQ
/// and ActiveMQ have one lane for each connection, Kafka one for each topic.
struct PublishLane {
  std::deque<std::shared_ptr<Outbox>> runnable;
  bool listed = false;  ///< listed in the core's list of lanes with something to send
};

/// A message that the transport was given and that has no answer yet. It keeps its address until one of PublishCore's
/// functions ends it.
struct UnderWay {
  std::shared_ptr<Outbox> outbox;
  AcceptedMessage accepted;
  // Used by the transport only.
  bool returned = false;  ///< the server returned it because nobody reads it; its confirmation is still to come
  EnvelopeBytes encoded;  ///< the encoded envelope, for transports that need its bytes until the answer
  std::list<UnderWay>::iterator self;
};

/// One connection to one kind of broker, which a PublishCore uses. The transport connects, sends and interprets
/// answers; the core decides what is sent when, and handles the outcomes.
///
/// The core calls all these functions with its mutex held, except make_outbox(). send(), send_alone() and
/// send_gathered() may release the mutex during I/O, and no other thread calls them meanwhile (see PublishCore::Turn);
/// the others keep it and do not block. If room(), send(), send_alone() or send_gathered() throws, the connection is
/// unusable and the core calls broke().
class PublishTransport {
 public:
  virtual ~PublishTransport() = default;

  /// Makes the Outbox of a new publisher, or of a class derived from it. Called without the mutex.
  virtual std::shared_ptr<Outbox> make_outbox(const Topic& topic, const PublisherOptions& options) {
    return std::make_shared<Outbox>(topic, options);
  }
  /// A publisher was added. The transport sets Outbox::ready now, or calls PublishCore::open() later; it may set
  /// Outbox::lane.
  virtual void added(const std::shared_ptr<Outbox>& outbox) = 0;

  enum class Room {
    yes,   ///< it can be sent without waiting
    full,  ///< nothing of this lane can be sent now
    /// Other publishers of the lane may go on; the transport calls make_runnable() when this one may, too.
    not_for_this_publisher,
  };
  /// Whether the next message of this publisher may be sent now.
  /// \param alone the message was just published, nothing waits before it, and send_alone() follows
  virtual Room room(const std::shared_ptr<Outbox>& outbox, const Message& next, bool alone) = 0;
  /// Sends a message for which there was room, or gathers it until send_gathered(), which follows.
  virtual void send(UnderWay& message) = 0;
  /// Sends a message at once, on the thread that published it.
  virtual void send_alone(UnderWay& message) {
    send(message);
    send_gathered();
  }
  /// Sends what send() has gathered.
  virtual void send_gathered() {}
  /// The connection failed while sending. Called while the exception is handled.
  virtual void broke(const char* why) noexcept = 0;

  /// A message waits although its publisher may send it: there was no room, or others wait before it.
  virtual void left_waiting(const std::shared_ptr<Outbox>& outbox, config::Clock::Instant now) = 0;
  /// Somebody waits for answers to the messages under way.
  virtual void want_answers() {}
  /// Wakes the transport's thread, which has something to do: report outcomes, fire timers, or send.
  virtual void wake() noexcept = 0;
};

}  // namespace iotcloud::brokers::client
