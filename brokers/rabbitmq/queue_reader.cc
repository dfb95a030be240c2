#include "iotcloud/brokers/rabbitmq/queue_reader.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "iotcloud/brokers/rabbitmq/read_connection.h"
#include "iotcloud/brokers/rabbitmq/wire/amqp_link.h"
#include "iotcloud/brokers/rabbitmq/wire/headers.h"
#include <iotcloud/brokers/rabbitmq/logger.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

/// Limit on a message's body. A larger size in a header means that the server is broken or not a RabbitMQ server.
constexpr std::uint64_t body_limit = std::uint64_t{1} << 30U;
/// Limit on a message's headers. A frame can hold many thousands, and looking for duplicates among them would take
/// long.
constexpr int header_limit = 2000;

}  // namespace

void Assembly::begin(const amqp_basic_deliver_t& deliver) {
  reset();
  arrived_.tag = deliver.delivery_tag;
  arrived_.redelivered = deliver.redelivered != 0;
  expects_header_ = true;
}

std::optional<Arrived> Assembly::header(const amqp_frame_t& frame, ResentMarks& resent) {
  if (!std::exchange(expects_header_, false)) throw LinkError("a message's header without a delivery");
  const std::uint64_t size = frame.payload.properties.body_size;
  if (size > body_limit) throw LinkError("a message of " + std::to_string(size) + " bytes");
  const auto& properties = *static_cast<const amqp_basic_properties_t*>(frame.payload.properties.decoded);
  too_many_headers_ =
      (properties._flags & AMQP_BASIC_HEADERS_FLAG) != 0 && properties.headers.num_entries > header_limit;
  if (!too_many_headers_) {
    const bool marked = decode_properties(properties, arrived_.message);
    if (resent.may_be_a_copy(origin_of(properties), marked)) arrived_.redelivered = true;
  }
  size_ = static_cast<std::size_t>(size);
  if (size_ == 0) return finish();
  bytes_ = std::shared_ptr<std::byte[]>(new std::byte[size_]);  // not zeroed, because all of it is overwritten
  return std::nullopt;
}

std::optional<Arrived> Assembly::body(amqp_bytes_t piece) {
  if (!bytes_ || piece.len > size_ - filled_) throw LinkError("a message's body that does not fit its header");
  std::memcpy(bytes_.get() + filled_, piece.bytes, piece.len);
  filled_ += piece.len;
  if (filled_ < size_) return std::nullopt;
  return finish();
}

std::optional<Arrived> Assembly::finish() {
  if (size_ > 0) {
    const std::span<const std::byte> bytes(bytes_.get(), size_);
    arrived_.message.payload = Payload::wrap(std::move(bytes_), bytes);
  }
  std::optional<Arrived> done(std::move(arrived_));
  const bool too_many_headers = too_many_headers_;
  reset();
  too_many_headers_ = too_many_headers;
  return done;
}

namespace {

std::string queue_of(const Topic& topic, const SubscriptionOptions& options) {
  if (!options.group.empty()) return topic.name + "." + options.group;
  return options.original_queue.empty() ? topic.name : options.original_queue;
}

}  // namespace

QueueReader::QueueReader(std::shared_ptr<ReadConnection> link, QueueType of_durable, Topic to, SubscriptionOptions how,
                         Handler what)
    : OwnDeliveryStream(std::move(to), std::move(how), std::move(what)),
      queue(queue_of(topic, options)),
      type(topic.durable ? of_durable : QueueType::classic),
      connection_(std::move(link)) {}

void QueueReader::settle(std::uint64_t tag, Settlement settlement) noexcept {
  connection()->settle(*this, tag, settlement);
}

std::shared_ptr<ReadConnection> QueueReader::connection() const {
  const config::MutexLock lock(connection_mutex_);
  return connection_;
}

void QueueReader::move_to(std::shared_ptr<ReadConnection> link) {
  const config::MutexLock lock(connection_mutex_);
  connection_ = std::move(link);
}

void QueueReader::request(AmqpLink& wire, amqp_channel_t on, std::uint16_t now) const {
  wire.send(on, AMQP_CHANNEL_OPEN_METHOD, amqp_channel_open_t{});
  const std::string& exchange = exchange_of(topic);
  if (must_declare(topic)) {
    amqp_exchange_declare_t declare{};
    declare.exchange = to_bytes(exchange);
    declare.type = amqp_cstring_bytes("direct");
    declare.durable = topic.durable ? 1 : 0;
    declare.passive = passive_exchange ? 1 : 0;
    wire.send(on, AMQP_EXCHANGE_DECLARE_METHOD, declare);
  }
  const bool original = options.group.empty() && !options.original_queue.empty();
  QueueArguments arguments(topic, original, type, options.exclusive);
  amqp_queue_declare_t declare{};
  declare.queue = to_bytes(queue);
  declare.durable = topic.durable ? 1 : 0;
  declare.auto_delete = original ? 1 : 0;
  declare.passive = passive_queue ? 1 : 0;
  declare.arguments = arguments.table();
  wire.send(on, AMQP_QUEUE_DECLARE_METHOD, declare);
  amqp_queue_bind_t bind{};
  bind.queue = to_bytes(queue);
  bind.exchange = to_bytes(exchange);
  bind.routing_key = to_bytes(topic.name);
  wire.send(on, AMQP_QUEUE_BIND_METHOD, bind);
  amqp_basic_qos_t qos{};
  qos.prefetch_count = std::max<std::uint16_t>(may_raise() ? options.prefetch_limit : options.prefetch, 1);
  wire.send(on, AMQP_BASIC_QOS_METHOD, qos);
  if (may_raise()) limit_channel(wire, on, now);
  amqp_basic_consume_t consume{};
  consume.queue = to_bytes(queue);
  consume.exclusive = options.exclusive && !one_reader_by_queue(topic, type) ? 1 : 0;
  wire.send(on, AMQP_BASIC_CONSUME_METHOD, consume);
}

void QueueReader::ask(AmqpLink& wire, amqp_channel_t on) const {
  amqp_queue_declare_t question{};
  question.queue = to_bytes(queue);
  question.passive = 1;
  wire.send(on, AMQP_QUEUE_DECLARE_METHOD, question);
}

void QueueReader::limit_channel(AmqpLink& wire, amqp_channel_t on, std::uint16_t now) {
  amqp_basic_qos_t qos{};
  qos.prefetch_count = std::max<std::uint16_t>(now, 1);
  qos.global = 1;
  wire.send(on, AMQP_BASIC_QOS_METHOD, qos);
}

void QueueReader::reading_began() {
  phase = Phase::active;
  read_before = true;
  retry_at.reset();
  backoff.reset();
  complaint.clear();
}

void QueueReader::refused(const amqp_channel_close_t& answer) {
  const bool was_active = phase == Phase::active;
  forget_channel();
  const std::string why = describe(answer);
  const bool other_properties = answer.reply_code == AMQP_PRECONDITION_FAILED;
  constexpr std::uint16_t exchange_class = 40;
  constexpr std::uint16_t queue_class = 50;
  constexpr std::uint16_t basic_class = 60;
  std::string now;
  if (answer.reply_code == AMQP_ACCESS_REFUSED && answer.class_id == basic_class &&
      why.find("exclusive") != std::string::npos) {
    return;  // another reader is exclusive: stand by
  }
  if (other_properties && answer.class_id == exchange_class && !passive_exchange) {
    passive_exchange = true;
    now = "exists with other properties; using it as it is: ";
  } else if (other_properties && answer.class_id == queue_class && !passive_queue) {
    passive_queue = true;
    now = "exists with other properties; using it as it is: ";
  } else if (answer.reply_code == AMQP_NOT_FOUND) {
    passive_exchange = passive_queue = false;
    now = "is gone; trying again: ";
  } else {
    now = was_active ? "was closed by the server; trying again: " : "cannot be read; trying again: ";
  }
  now += why;
  if (std::exchange(complaint, now) != now) logger.warn("queue {} {}", queue, now);
}

void QueueReader::forget_channel() {
  phase = Phase::idle;
  channel = 0;
  backlog.reset();
  asks = false;
  begin_anew();
  assembly.reset();
}

}  // namespace iotcloud::brokers::rabbitmq
