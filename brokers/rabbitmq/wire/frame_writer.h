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

/// Gathers the frames of messages to be published, and sends them with one system call: librabbitmq takes three for
/// each message (its method, its header, its body) and copies the body once more. What stands in the frames the library
/// encodes; here they are only put side by side. For plain TCP: TLS is the library's alone. Not thread safe.
class FrameWriter {
 public:
  /// \param frame_max the largest frame, in bytes, that server and client have agreed on
  explicit FrameWriter(std::size_t frame_max);

  /// Adds a basic.publish with the flag `mandatory`. The body must live until send().
  /// \throws LinkError when the properties do not fit into a frame; what was gathered is of no use then.
  void add(amqp_channel_t channel, const std::string& exchange, const std::string& key,
           const amqp_basic_properties_t& properties, std::span<const std::byte> body);
  std::size_t gathered() const { return gathered_; }  ///< bytes
  /// So much was gathered that more would only wait: send() comes next.
  bool full() const;
  /// Sends what was gathered; waits while the socket has no room. \throws LinkError when the connection broke.
  /// \param more_follows the kernel may hold back what does not fill a packet, for 200 ms at most
  void send(int descriptor, bool more_follows);

 private:
  template <typename Number>
  void put(Number number);
  void put_head(std::uint8_t type, amqp_channel_t channel, std::size_t size);
  /// Completes a frame whose payload stands at end_, with room for the head before it.
  void put_frame(std::uint8_t type, amqp_channel_t channel, std::size_t size);
  void add_body(amqp_channel_t channel, std::span<const std::byte> part);
  void close_piece();

  const std::size_t frame_max_;
  const std::unique_ptr<std::byte[]> buffer_;  ///< all but large bodies; never moves
  std::byte* end_;                             ///< of what is written in it
  std::byte* piece_;                           ///< where the piece that is being written begins
  std::vector<iovec> pieces_;                  ///< finished ones
  std::size_t gathered_ = 0;
};

}  // namespace iotcloud::brokers::rabbitmq
