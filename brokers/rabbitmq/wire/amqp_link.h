#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>

#include <amqp.h>

#include "iotcloud/brokers/broker_url.h"
#include "iotcloud/brokers/rabbitmq/wire/declarations.h"
#include "iotcloud/brokers/rabbitmq/wire/frame_writer.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// The connection is lost or the server refused it; the text says why. Caught by the links, never seen by users.
class LinkError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct LinkOptions {
  BrokerUrl url;  ///< with the user and password that count
  Tls tls;        ///< when the URL's scheme is "amqps"
  std::chrono::milliseconds heartbeat{4000};
  std::chrono::milliseconds rpc_timeout{5000};  ///< also for connecting and logging in
  std::string purpose;                          ///< shown by RabbitMQ's tools: "publishing", "consuming"
  int channels = 2047;                          ///< at most; RabbitMQ's own default limit. The server may allow fewer
};

/// One open connection to RabbitMQ: librabbitmq's state behind an owning wrapper that keeps clear of its traps.
/// Not thread safe, `descriptor()` and `push()` apart: one thread at a time. Methods throw LinkError when the
/// connection is lost; it is of no use then.
class AmqpLink {
 public:
  /// Connects and logs in; waits at most twice the time-out.
  explicit AmqpLink(const LinkOptions& options);
  /// Closes the socket without a word: call close() first when the server is to keep what was sent.
  ~AmqpLink();
  AmqpLink(const AmqpLink&) = delete;
  AmqpLink& operator=(const AmqpLink&) = delete;

  int descriptor() const { return descriptor_; }
  int channel_limit() const;
  std::chrono::seconds heartbeat() const;

  /// The next frame that is there, without waiting; reads the socket, sends a heartbeat when one is due and throws when
  /// the server's are overdue. What it points to dies with release(). After it, go on while has_buffered().
  std::optional<amqp_frame_t> next_frame();
  /// Frames or parts of them that the library holds already: poll() would not tell. (Under TLS there is no third place:
  /// the library takes whole records, which are smaller than its buffer, so OpenSSL keeps none.)
  bool has_buffered() const;
  /// Gives back the memory of the frames of a channel.
  void release(amqp_channel_t channel);

  /// Whether a body of this size goes into the socket's send buffer without waiting.
  bool room_for(std::size_t body_size);
  /// The message leaves with flush(), or before: the body must live until then. Waits when there is no room.
  void publish(amqp_channel_t channel, const std::string& exchange, const std::string& key,
               const amqp_basic_properties_t& properties, std::span<const std::byte> body);
  /// \param more_follows in a moment: the kernel may hold back the end until then, or until push()
  /// \return whether it may hold back something
  bool flush(bool more_follows);
  /// Makes the kernel send what it holds back. Thread safe.
  void push();
  /// Sends one method, without waiting for an answer.
  template <typename Method>
  void send(amqp_channel_t channel, amqp_method_number_t number, Method method) {
    send_method(channel, number, &method);
  }

  /// Opens a channel and waits for the answer.
  void open_channel(amqp_channel_t channel);
  void select_confirms(amqp_channel_t channel);
  /// Declares a direct exchange on a channel of its own that is opened for it. \return empty, or why the server
  /// refused.
  std::string declare_exchange(amqp_channel_t channel, const std::string& exchange, bool durable);
  /// The topic's own queue, bound to its exchange; one that is there with other properties is used as it is.
  /// \return empty, or why the server refused.
  std::string declare_queue(amqp_channel_t channel, const Topic& topic, QueueType type);
  /// Ends channel and connection in order, so that the server keeps all that was sent. Waits at most the time-out.
  void close(amqp_channel_t channel) noexcept;

 private:
  struct Destroyer {
    void operator()(amqp_connection_state_t_* state) const { amqp_destroy_connection(state); }
  };
  void send_method(amqp_channel_t channel, amqp_method_number_t number, void* decoded);
  void check(const amqp_rpc_reply_t& reply, const char* doing) const;
  /// Of the last request. \return empty when the server did it; otherwise why it did not, the channel being closed.
  std::string refusal_of(amqp_channel_t channel, const char* doing);

  /// Of the kernel, which counts its own overhead too.
  struct SendBuffer {
    std::size_t queued = 0;
    std::size_t size = 0;
  };
  SendBuffer look_at_buffer() const;

  std::unique_ptr<amqp_connection_state_t_, Destroyer> state_;
  int descriptor_ = -1;
  const bool tls_;
  std::unique_ptr<FrameWriter> writer_;  ///< made for the first message; none under TLS
  SendBuffer buffer_;  ///< when it was looked at last, and `queued` at most since: asking each time would cost a call
};

amqp_bytes_t to_bytes(const std::string& text);
std::string to_string(amqp_bytes_t bytes);
/// "403 ACCESS_REFUSED - ..." of a channel.close or connection.close.
std::string describe(const amqp_channel_close_t& closed);
std::string describe(const amqp_connection_close_t& closed);

}  // namespace iotcloud::brokers::rabbitmq
