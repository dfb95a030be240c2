#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"

#include <algorithm>
#include <array>
#include <cstdint>

#include <fmt/core.h>
#include <linux/sockios.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include "iotcloud/brokers/rabbitmq/wire/declarations.h"
#include "iotcloud/brokers/rabbitmq/wire/socket.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

constexpr int wanted_frame = 131072;  // RabbitMQ's own default

// The kernel also counts its own overhead against the buffer: at most an eighth, and a constant for each message.
constexpr std::size_t some_heads = 16384;  // of frames
constexpr std::size_t overhead_of_one = 2048;
constexpr std::size_t with_overhead(std::size_t bytes) {
  return bytes + bytes / 8;
}

timeval to_timeval(std::chrono::milliseconds duration) {
  timeval value{};
  value.tv_sec = duration.count() / 1000;
  value.tv_usec = duration.count() % 1000 * 1000;
  return value;
}

amqp_table_entry_t flag(const char* name) {
  amqp_table_entry_t entry{};
  entry.key = amqp_cstring_bytes(name);
  entry.value.kind = AMQP_FIELD_KIND_BOOLEAN;
  entry.value.value.boolean = 1;
  return entry;
}

std::string describe_reply(const amqp_rpc_reply_t& reply) {
  if (reply.reply_type == AMQP_RESPONSE_SERVER_EXCEPTION) {
    if (reply.reply.id == AMQP_CONNECTION_CLOSE_METHOD) {
      return describe(*static_cast<const amqp_connection_close_t*>(reply.reply.decoded));
    }
    if (reply.reply.id == AMQP_CHANNEL_CLOSE_METHOD) {
      return describe(*static_cast<const amqp_channel_close_t*>(reply.reply.decoded));
    }
  }
  if (reply.reply_type == AMQP_RESPONSE_LIBRARY_EXCEPTION) return explain(reply.library_error);
  return "unexpected answer";
}

}  // namespace

amqp_bytes_t to_bytes(const std::string& text) {
  amqp_bytes_t bytes;
  bytes.len = text.size();
  bytes.bytes = const_cast<char*>(text.data());  // the library takes only non-const pointers, but does not write
  return bytes;
}

std::string to_string(amqp_bytes_t bytes) {
  return bytes.len == 0 ? std::string() : std::string(static_cast<const char*>(bytes.bytes), bytes.len);
}

std::string describe(const amqp_channel_close_t& closed) {
  return fmt::format("{} {}", closed.reply_code, to_string(closed.reply_text));
}

std::string describe(const amqp_connection_close_t& closed) {
  return fmt::format("{} {}", closed.reply_code, to_string(closed.reply_text));
}

AmqpLink::AmqpLink(const AmqpLinkOptions& options) : state_(amqp_new_connection()), tls_(wants_tls(options.url)) {
  if (!state_) throw LinkError("out of memory");
  amqp_socket_t* socket = make_socket(state_.get(), options.url, options.tls);
  if (tls_) shown_ = guard(socket, *options.trust);
  const timeval limit = to_timeval(options.rpc_timeout);
  amqp_set_handshake_timeout(state_.get(), &limit);
  amqp_set_rpc_timeout(state_.get(), &limit);
  open_socket(socket, options.url, options.rpc_timeout);
  descriptor_ = amqp_get_sockfd(state_.get());

  std::array capabilities{flag("connection.blocked"), flag("consumer_cancel_notify"), flag("publisher_confirms"),
                          flag("basic.nack")};
  std::array<amqp_table_entry_t, 2> properties{};
  properties[0].key = amqp_cstring_bytes("capabilities");
  properties[0].value.kind = AMQP_FIELD_KIND_TABLE;
  properties[0].value.value.table = {static_cast<int>(capabilities.size()), capabilities.data()};
  properties[1].key = amqp_cstring_bytes("connection_name");
  properties[1].value.kind = AMQP_FIELD_KIND_UTF8;
  const std::string name = "iotcloud " + options.purpose;
  properties[1].value.value.bytes = to_bytes(name);
  const amqp_table_t table{static_cast<int>(properties.size()), properties.data()};
  const std::string host = options.url.path.empty() ? "/" : options.url.path;
  const std::string user = options.url.user.empty() ? "guest" : options.url.user;
  const std::string password = options.url.password.empty() ? "guest" : options.url.password;
  const int heartbeat = std::max(1, static_cast<int>(options.heartbeat.count() / 1000));
  check(amqp_login_with_properties(state_.get(), host.c_str(), options.channels, wanted_frame, heartbeat, &table,
                                   AMQP_SASL_METHOD_PLAIN, user.c_str(), password.c_str()),
        "log in");
}

AmqpLink::~AmqpLink() = default;

int AmqpLink::channel_limit() const {
  const int limit = amqp_get_channel_max(state_.get());
  return limit > 0 ? limit : 65535;
}

std::chrono::seconds AmqpLink::heartbeat() const {
  return std::chrono::seconds(amqp_get_heartbeat(state_.get()));
}

void AmqpLink::check(const amqp_rpc_reply_t& reply, const char* doing) const {
  if (reply.reply_type != AMQP_RESPONSE_NORMAL)
    throw LinkError(fmt::format("cannot {}: {}", doing, describe_reply(reply)));
}

std::optional<amqp_frame_t> AmqpLink::next_frame() {
  amqp_frame_t frame;
  const timeval no_wait{0, 0};
  const int status = amqp_simple_wait_frame_noblock(state_.get(), &frame, &no_wait);
  if (status == AMQP_STATUS_TIMEOUT) return std::nullopt;
  if (status != AMQP_STATUS_OK) throw LinkError(explain(status));
  return frame;
}

bool AmqpLink::has_buffered() const {
  return amqp_frames_enqueued(state_.get()) != 0 || amqp_data_in_buffer(state_.get()) != 0;
}

void AmqpLink::release(amqp_channel_t channel) {
  amqp_maybe_release_buffers_on_channel(state_.get(), channel);
}

AmqpLink::SendBuffer AmqpLink::look_at_buffer() const {
  std::array<std::uint32_t, 16> memory{};  // linux/sock_diag.h: SK_MEMINFO_*
  constexpr std::size_t send_buffer = 3;
  constexpr std::size_t write_queued = 5;
  socklen_t length = sizeof(memory);
#ifdef SO_MEMINFO
  if (::getsockopt(descriptor_, SOL_SOCKET, SO_MEMINFO, memory.data(), &length) == 0 &&
      length > write_queued * sizeof(memory[0])) {
    return {memory[write_queued], memory[send_buffer]};
  }
#endif
  int queued = 0;
  int size = 0;
  length = sizeof(size);
  if (::ioctl(descriptor_, SIOCOUTQ, &queued) != 0 ||
      ::getsockopt(descriptor_, SOL_SOCKET, SO_SNDBUF, &size, &length) != 0) {
    return {};
  }
  // The queue's overhead is unknown here: count the bytes twice.
  return {2 * static_cast<std::size_t>(queued), static_cast<std::size_t>(size)};
}

bool AmqpLink::room_for(std::size_t body_size) {
  const std::size_t needed = with_overhead(body_size) + some_heads;
  // The buffer now holds at most its bytes at the last look plus those sent since. The other half is a reserve, for
  // packets that the kernel splits and for a buffer that it shrinks.
  if (buffer_.queued + needed <= buffer_.size / 2) return true;
  const std::size_t gathered = writer_ ? writer_->gathered() : 0;
  buffer_ = look_at_buffer();
  buffer_.queued += with_overhead(gathered);
  return buffer_.queued + needed <= buffer_.size;
}

void AmqpLink::publish(amqp_channel_t channel, const std::string& exchange, const std::string& key,
                       const amqp_basic_properties_t& properties, std::span<const std::byte> body) {
  if (tls_) {
    buffer_.queued += with_overhead(body.size()) + some_heads;
    amqp_bytes_t bytes;
    bytes.len = body.size();
    bytes.bytes = const_cast<std::byte*>(body.data());  // as in to_bytes()
    constexpr amqp_boolean_t mandatory = 1;
    const int status =
        amqp_basic_publish(state_.get(), channel, to_bytes(exchange), to_bytes(key), mandatory, 0, &properties, bytes);
    if (status != AMQP_STATUS_OK) throw LinkError(explain(status));
    return;
  }
  if (!writer_) {
    writer_ = std::make_unique<FrameWriter>(static_cast<std::size_t>(amqp_get_frame_max(state_.get())));
  }
  // The full writer is flushed before it gets this message, not after: a flush tells the kernel that more bytes follow,
  // so the kernel may hold the last ones back, and this message may be the last one.
  if (writer_->full()) flush(true);
  const std::size_t before = writer_->gathered();
  writer_->add(channel, exchange, key, properties, body);
  buffer_.queued += with_overhead(writer_->gathered() - before) + overhead_of_one;
}

bool AmqpLink::flush(bool more_follows) {
  if (!writer_) return false;
  writer_->send(descriptor_, more_follows);
  return more_follows;
}

void AmqpLink::push() {
  const int on = 1;  // it is set already; setting it again makes the kernel send held-back bytes
  ::setsockopt(descriptor_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof(on));
}

void AmqpLink::send_method(amqp_channel_t channel, amqp_method_number_t number, void* decoded) {
  buffer_.queued += overhead_of_one;
  const int status = amqp_send_method(state_.get(), channel, number, decoded);
  if (status != AMQP_STATUS_OK) throw LinkError(explain(status));
}

void AmqpLink::open_channel(amqp_channel_t channel) {
  amqp_channel_open(state_.get(), channel);
  check(amqp_get_rpc_reply(state_.get()), "open a channel");
}

void AmqpLink::select_confirms(amqp_channel_t channel) {
  amqp_confirm_select(state_.get(), channel);
  check(amqp_get_rpc_reply(state_.get()), "ask for confirmations");
}

std::string AmqpLink::declare_exchange(amqp_channel_t channel, const std::string& exchange, bool durable) {
  open_channel(channel);
  amqp_exchange_declare(state_.get(), channel, to_bytes(exchange), amqp_cstring_bytes("direct"), 0, durable ? 1 : 0, 0,
                        0, amqp_empty_table);
  std::string why = refusal_of(channel, "declare an exchange");
  if (why.empty()) check(amqp_channel_close(state_.get(), channel, AMQP_REPLY_SUCCESS), "close a channel");
  return why;
}

std::string AmqpLink::declare_queue(amqp_channel_t channel, const Topic& topic, const std::string& original,
                                    QueueType type) {
  open_channel(channel);
  const bool automatic = !original.empty();
  const std::string& queue = automatic ? original : topic.name;
  QueueArguments arguments(topic, automatic, type, true);
  amqp_queue_declare(state_.get(), channel, to_bytes(queue), 0, topic.durable ? 1 : 0, 0, automatic ? 1 : 0,
                     arguments.table());
  std::string why = refusal_of(channel, "declare a queue");
  // The queue may exist with other properties; a refusal has closed the channel.
  if (!why.empty()) open_channel(channel);
  amqp_queue_bind(state_.get(), channel, to_bytes(queue), to_bytes(exchange_of(topic)), to_bytes(topic.name),
                  amqp_empty_table);
  if (const std::string unbound = refusal_of(channel, "bind a queue"); !unbound.empty()) {
    return why.empty() ? unbound : why;
  }
  check(amqp_channel_close(state_.get(), channel, AMQP_REPLY_SUCCESS), "close a channel");
  return {};
}

std::string AmqpLink::remove_idle_queue(amqp_channel_t channel, const std::string& queue) {
  constexpr amqp_boolean_t if_unused = 1;
  constexpr amqp_boolean_t if_empty = 1;
  open_channel(channel);
  amqp_queue_delete(state_.get(), channel, to_bytes(queue), if_unused, if_empty);
  std::string why = refusal_of(channel, "remove a queue");
  if (why.empty()) check(amqp_channel_close(state_.get(), channel, AMQP_REPLY_SUCCESS), "close a channel");
  return why;
}

std::string AmqpLink::refusal_of(amqp_channel_t channel, const char* doing) {
  const amqp_rpc_reply_t reply = amqp_get_rpc_reply(state_.get());
  if (reply.reply_type == AMQP_RESPONSE_NORMAL) return {};
  if (reply.reply_type != AMQP_RESPONSE_SERVER_EXCEPTION || reply.reply.id != AMQP_CHANNEL_CLOSE_METHOD) {
    check(reply, doing);
  }
  std::string why = describe_reply(reply);
  send(channel, AMQP_CHANNEL_CLOSE_OK_METHOD, amqp_channel_close_ok_t{});
  return why;
}

void AmqpLink::close(amqp_channel_t channel) noexcept {
  if (channel != 0) amqp_channel_close(state_.get(), channel, AMQP_REPLY_SUCCESS);
  amqp_connection_close(state_.get(), AMQP_REPLY_SUCCESS);
}

}  // namespace iotcloud::brokers::rabbitmq
