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
#include "iotcloud/brokers/server_trust.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::rabbitmq {

/// The connection is lost or the server refused it; the text says why. The links catch it, users never see it.
class LinkError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct AmqpLinkOptions {
  BrokerUrl url;                 ///< with the effective user and password
  Tls tls;                       ///< when the URL's scheme is "amqps"
  ServerTrust* trust = nullptr;  ///< of the files in `tls`; not null with TLS
  std::chrono::milliseconds heartbeat{4000};
  std::chrono::milliseconds rpc_timeout{5000};  ///< also for connecting and logging in
  std::string purpose;                          ///< shown by RabbitMQ's tools: "publishing", "consuming"
  int channels = 2047;                          ///< at most; RabbitMQ's own default. The server may allow fewer
};

/// One open connection to RabbitMQ: librabbitmq's state in an owning wrapper that avoids its traps. One thread at a
/// time may use it; only `descriptor()` and `push()` are thread safe. Methods throw LinkError when the connection is
/// lost; it is then of no further use.
class AmqpLink {
 public:
  /// Connects and logs in; waits at most twice the time-out.
  explicit AmqpLink(const AmqpLinkOptions& options);
  /// Closes the socket without AMQP's closing handshake: call close() first if the server must keep what was sent.
  ~AmqpLink();
  AmqpLink(const AmqpLink&) = delete;
  AmqpLink& operator=(const AmqpLink&) = delete;

  int descriptor() const { return descriptor_; }
  /// What the server showed at the handshake; null: the connection has no TLS.
  const std::shared_ptr<ShownChain>& shown() const { return shown_; }
  int channel_limit() const;
  std::chrono::seconds heartbeat() const;

  /// The next available frame, without waiting. Reads the socket, sends a heartbeat if one is due, and throws if the
  /// server's are overdue. release() frees the frame's memory. Repeat while has_buffered().
  std::optional<amqp_frame_t> next_frame();
  /// Whether the library holds frames or parts of them, which poll() would not show. (OpenSSL holds none: the library
  /// reads whole records, which are smaller than its buffer.)
  bool has_buffered() const;
  /// Frees the memory of a channel's frames.
  void release(amqp_channel_t channel);

  /// Whether a message with a body of this size, or with 0 some methods, fits into the socket's send buffer without
  /// waiting.
  bool room_for(std::size_t body_size);
  /// Sends the message with flush(), or before: the body must live until then. Waits if there is no room.
  void publish(amqp_channel_t channel, const std::string& exchange, const std::string& key,
               const amqp_basic_properties_t& properties, std::span<const std::byte> body);
  /// \param more_follows more is sent in a moment: the kernel may hold back the last packet until then, or until push()
  /// \return whether it may hold back bytes
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
  /// Declares a direct exchange on a channel that is opened for it. \return empty, or why the server refused.
  std::string declare_exchange(amqp_channel_t channel, const std::string& exchange, bool durable);
  /// Declares the topic's own queue, bound to its exchange; an existing one with other properties is used as it is.
  /// \param original see PublisherOptions::original_queue. \return empty, or why the server refused.
  std::string declare_queue(amqp_channel_t channel, const Topic& topic, const std::string& original, QueueType type);
  /// Removes a queue that has no message and no reader, on a channel that is opened for it. Quorum queues refuse this.
  /// \return empty, or why the server refused.
  std::string remove_idle_queue(amqp_channel_t channel, const std::string& queue);
  /// Closes channel and connection in order, so that the server keeps all that was sent. Waits at most the time-out.
  void close(amqp_channel_t channel) noexcept;

 private:
  struct Destroyer {
    void operator()(amqp_connection_state_t_* state) const { amqp_destroy_connection(state); }
  };
  void send_method(amqp_channel_t channel, amqp_method_number_t number, void* decoded);
  void check(const amqp_rpc_reply_t& reply, const char* doing) const;
  /// The result of the last request. \return empty if it succeeded; otherwise the reason, and the channel is closed.
  std::string refusal_of(amqp_channel_t channel, const char* doing);

  /// The kernel's view, including its own overhead.
  struct SendBuffer {
    std::size_t queued = 0;
    std::size_t size = 0;
  };
  SendBuffer look_at_buffer() const;

  std::shared_ptr<ShownChain> shown_;  ///< outlives state_
  std::unique_ptr<amqp_connection_state_t_, Destroyer> state_;
  int descriptor_ = -1;
  const bool tls_;
  std::unique_ptr<FrameWriter> writer_;  ///< made for the first message; not used under TLS
  /// The state at the last look. `queued` has been kept as an upper bound since, which saves a system call for each
  /// message.
  SendBuffer buffer_;
};

amqp_bytes_t to_bytes(const std::string& text);
std::string to_string(amqp_bytes_t bytes);
/// "403 ACCESS_REFUSED - ..." of a channel.close or connection.close.
std::string describe(const amqp_channel_close_t& closed);
std::string describe(const amqp_connection_close_t& closed);

}  // namespace iotcloud::brokers::rabbitmq
