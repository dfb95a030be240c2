#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <amqp.h>
#include <sys/uio.h>

namespace iotcloud::brokers::rabbitmq {

/// Gathers the frames of messages and sends them with one system call: librabbitmq makes three for each message (its
/// method, its header, its body) and copies the body once more. The library still encodes the frames' contents. For
/// plain TCP only: with TLS the library sends. Not thread safe.
class FrameWriter {
 public:
  /// \param frame_max the largest frame, in bytes, on which server and client agreed
  explicit FrameWriter(std::size_t frame_max);

  /// Adds a basic.publish with the flag `mandatory`. The body must live until send().
  /// \throws LinkError if the properties do not fit into a frame; the gathered bytes are then of no use.
  void add(amqp_channel_t channel, const std::string& exchange, const std::string& key,
           const amqp_basic_properties_t& properties, std::span<const std::byte> body);
  std::size_t gathered() const { return gathered_; }  ///< bytes
  /// Whether enough is gathered: call send() next.
  bool full() const;
  /// Sends the gathered bytes; waits while the socket has no room. \throws LinkError if the connection broke.
  /// \param more_follows the kernel may hold back an incomplete packet, for 200 ms at most
  void send(int descriptor, bool more_follows);

 private:
  template <typename Number>
  void put(Number number);
  void put_head(std::uint8_t type, amqp_channel_t channel, std::size_t size);
  /// Completes a frame whose payload is at end_, with room for the head before it.
  void put_frame(std::uint8_t type, amqp_channel_t channel, std::size_t size);
  void add_body(amqp_channel_t channel, std::span<const std::byte> part);
  void close_piece();

  const std::size_t frame_max_;
  const std::unique_ptr<std::byte[]> buffer_;  ///< everything but large bodies; never moves
  std::byte* end_;                             ///< end of the written bytes in buffer_
  std::byte* piece_;                           ///< start of the current piece
  std::vector<iovec> pieces_;                  ///< finished ones
  std::size_t gathered_ = 0;
};

}  // namespace iotcloud::brokers::rabbitmq
