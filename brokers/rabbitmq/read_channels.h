#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <vector>

#include "iotcloud/brokers/rabbitmq/queue_reader.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/wire/declarations.h"

namespace iotcloud::brokers::rabbitmq {

/// The channels of one consuming connection: which subscription reads on which, and the methods that are still to be
/// sent on them (requests, limits, settlements, closes). Only the thread that has the connection's WireTurn uses it.
/// Functions that change a subscription (open, close, settle) need the mutex of its connection, too; writing does not,
/// so that the connection writes without it.
class ReadChannels {
 public:
  /// The number of channels that are open, or about to be opened or closed.
  std::size_t size() const { return readers_.size(); }
  /// The reader of a channel; null: this client has requested the channel's end; nullopt: there is no such channel.
  std::optional<QueueReader*> find(amqp_channel_t channel) const;

  /// Gives a subscription a channel, and requests there what it reads.
  void open(const std::shared_ptr<QueueReader>& reader);
  /// Requests the end of a subscription's channel. The number is free again when the server has answered: closed().
  void close(QueueReader& reader);
  /// The server has closed a channel in answer to close().
  void closed(amqp_channel_t channel) { readers_.erase(channel); }
  /// The server has closed a channel by itself: after that only close-ok may be sent on it.
  void closed_by_server(amqp_channel_t channel);
  /// Tells the server the subscription's prefetch, which was raised.
  void limit(const QueueReader& reader);
  /// Asks the server how many messages the subscription's queue has.
  void ask(const std::shared_ptr<QueueReader>& reader);
  /// Takes the settlements of a subscription's messages. \param patience as in AckWindow::take()
  void settle(QueueReader& reader, std::size_t patience);

  /// Tells whether poll() reported room, so that the next method can be written without asking the socket.
  void socket_has_room(bool room) { writable_ = room; }
  /// Writes methods as far as the socket takes them at once. \throws LinkError
  void write(AmqpLink& wire);
  /// Writes all methods; waits until the socket takes them. \throws LinkError
  void write_all(AmqpLink& wire);
  bool all_written() const { return outgoing_.empty(); }
  /// The connection is gone, and all channels with it.
  void clear();

 private:
  /// A method that is to be sent on a channel.
  struct Outgoing {
    enum class Kind : std::uint8_t { request, limit, ask, acknowledge, reject, close, close_ok };
    Kind kind = Kind::request;
    amqp_channel_t channel = 0;
    std::uint64_t tag = 0;  ///< for an acknowledgement or a rejection; the prefetch of a request or a limit
    bool multiple = false;
    std::shared_ptr<const QueueReader> reader;  ///< of a request or a question
  };

  amqp_channel_t lowest_free() const;
  void write_method(AmqpLink& wire, const Outgoing& what) const;

  std::map<amqp_channel_t, std::shared_ptr<QueueReader>> readers_;
  std::vector<Outgoing> outgoing_;
  bool writable_ = false;  ///< see socket_has_room()
};

}  // namespace iotcloud::brokers::rabbitmq
