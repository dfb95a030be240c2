#include "iotcloud/brokers/rabbitmq/wire/frame_writer.h"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstring>

#include <amqp_framing.h>
#include <poll.h>
#include <sys/socket.h>

#include "iotcloud/brokers/limits.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/wire/socket.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

// AMQP 0-9-1, 4.2.3: type, channel and size before the payload, a mark after it.
constexpr std::size_t frame_head = 7;
constexpr std::size_t frame_overhead = frame_head + 1;
constexpr std::uint8_t frame_end = 0xCE;
// A header frame begins with its class, its weight and the body's size.
constexpr std::size_t header_head = 12;

// Bodies up to this size are copied, which costs less than another piece.
constexpr std::size_t small_body = 2048;
// Gathered bytes are sent when they are this many, so that the server reads them while the rest is made.
constexpr std::size_t gathering_limit = 65536;
// The largest frame with basic.publish: two short strings and little else.
constexpr std::size_t largest_method = 1024;

/// The most that one message takes of the buffer: the method, a header of a whole frame, the heads of its body's
/// frames.
std::size_t most_of_one(std::size_t frame_max) {
  const std::size_t body_frames = max_payload / (frame_max - frame_overhead) + 1;
  return largest_method + frame_max + body_frames * frame_overhead + small_body;
}

}  // namespace

FrameWriter::FrameWriter(std::size_t frame_max)
    : frame_max_(frame_max),
      buffer_(new std::byte[gathering_limit + most_of_one(frame_max)]),
      end_(buffer_.get()),
      piece_(buffer_.get()) {}

template <typename Number>
void FrameWriter::put(Number number) {
  for (std::size_t shift = sizeof(Number) * CHAR_BIT; shift > 0;) {
    shift -= CHAR_BIT;
    *end_++ = static_cast<std::byte>(number >> shift & 0xFFU);
  }
}

void FrameWriter::put_head(std::uint8_t type, amqp_channel_t channel, std::size_t size) {
  put(type);
  put(channel);
  put(static_cast<std::uint32_t>(size));
}

void FrameWriter::put_frame(std::uint8_t type, amqp_channel_t channel, std::size_t size) {
  std::byte* const end = end_ + size;
  end_ -= frame_head;
  put_head(type, channel, size);
  end_ = end;
  put(frame_end);
}

void FrameWriter::add(amqp_channel_t channel, const std::string& exchange, const std::string& key,
                      const amqp_basic_properties_t& properties, std::span<const std::byte> body) {
  const std::byte* const begin = end_;
  const auto encoded = [](int size) {
    if (size < 0) throw LinkError(explain(size));
    return static_cast<std::size_t>(size);
  };
  amqp_basic_publish_t publish{};
  publish.exchange = to_bytes(exchange);
  publish.routing_key = to_bytes(key);
  publish.mandatory = 1;
  end_ += frame_head;
  std::byte* payload = end_;
  put(static_cast<std::uint32_t>(AMQP_BASIC_PUBLISH_METHOD));
  const std::size_t method =
      encoded(amqp_encode_method(AMQP_BASIC_PUBLISH_METHOD, &publish, {largest_method - frame_overhead, end_}));
  end_ = payload;
  put_frame(AMQP_FRAME_METHOD, channel, sizeof(amqp_method_number_t) + method);

  end_ += frame_head;
  payload = end_;
  put(static_cast<std::uint16_t>(AMQP_BASIC_CLASS));
  put(std::uint16_t{0});
  put(static_cast<std::uint64_t>(body.size()));
  // The library does not write to the properties, although its type says so.
  const std::size_t values =
      encoded(amqp_encode_properties(AMQP_BASIC_CLASS, const_cast<amqp_basic_properties_t*>(&properties),
                                     {frame_max_ - frame_overhead - header_head, end_}));
  end_ = payload;
  put_frame(AMQP_FRAME_HEADER, channel, header_head + values);

  gathered_ += static_cast<std::size_t>(end_ - begin);
  while (!body.empty()) {
    const std::size_t size = std::min(body.size(), frame_max_ - frame_overhead);
    add_body(channel, body.first(size));
    body = body.subspan(size);
  }
}

void FrameWriter::add_body(amqp_channel_t channel, std::span<const std::byte> part) {
  put_head(AMQP_FRAME_BODY, channel, part.size());
  if (part.size() <= small_body) {
    end_ = std::copy(part.begin(), part.end(), end_);
  } else {
    close_piece();
    pieces_.push_back({const_cast<std::byte*>(part.data()), part.size()});  // it is only read
  }
  put(frame_end);
  gathered_ += part.size() + frame_overhead;
}

void FrameWriter::close_piece() {
  if (end_ > piece_) pieces_.push_back({piece_, static_cast<std::size_t>(end_ - piece_)});
  piece_ = end_;
}

bool FrameWriter::full() const {
  return gathered_ >= gathering_limit;
}

void FrameWriter::send(int descriptor, bool more_follows) {
  close_piece();
  for (std::size_t first = 0; first < pieces_.size();) {
    msghdr message{};
    message.msg_iov = &pieces_[first];
    message.msg_iovlen = std::min<std::size_t>(pieces_.size() - first, IOV_MAX);
    const ssize_t written = ::sendmsg(descriptor, &message, more_follows ? MSG_NOSIGNAL | MSG_MORE : MSG_NOSIGNAL);
    if (written < 0) {
      if (errno == EINTR) continue;
      if (errno != EAGAIN && errno != EWOULDBLOCK) throw LinkError(explain(AMQP_STATUS_SOCKET_ERROR));
      pollfd waiting{descriptor, POLLOUT, 0};
      ::poll(&waiting, 1, -1);
      continue;
    }
    std::size_t sent = static_cast<std::size_t>(written);
    for (; first < pieces_.size() && sent >= pieces_[first].iov_len; ++first) sent -= pieces_[first].iov_len;
    if (sent == 0) continue;
    pieces_[first].iov_base = static_cast<std::byte*>(pieces_[first].iov_base) + sent;
    pieces_[first].iov_len -= sent;
  }
  pieces_.clear();
  end_ = piece_ = buffer_.get();
  gathered_ = 0;
}

}  // namespace iotcloud::brokers::rabbitmq
