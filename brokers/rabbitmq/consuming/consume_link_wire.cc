// What the consuming link says to the server and makes of its answers.
#include <algorithm>
#include <utility>

#include "iotcloud/brokers/rabbitmq/consuming/consume_link.h"
#include "iotcloud/brokers/rabbitmq/wire/declarations.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

const config::Logger logger{"brokers.rabbitmq"};

// Frames, and bytes of bodies, taken in a row before handlers run again: what was read last lies in the processor's
// cache, megabytes do not.
constexpr std::size_t frames_in_a_row = 1024;
constexpr std::size_t bytes_in_a_row = 131072;
// Subscriptions that the server is asked for at once: it may take milliseconds for each, and of thousands the last
// would have waited for longer than an answer may take.
constexpr std::size_t most_opening = 64;

}  // namespace

void ConsumeLink::read_frames() {
  std::size_t count = 0;
  std::size_t bytes = 0;
  do {
    const std::optional<amqp_frame_t> frame = wire_->next_frame();
    if (!frame) return;
    if (frame->frame_type == AMQP_FRAME_BODY) bytes += frame->payload.body_fragment.len;
    on_frame(*frame);
    wire_->release(frame->channel);
    if (std::exchange(openers_wait_, false)) next_timer_ = clock_.now();
    if (bytes >= bytes_in_a_row && !ready_.empty() && !handling_) return;
  } while (wire_->has_buffered() && ++count < frames_in_a_row);
}

void ConsumeLink::on_frame(const amqp_frame_t& frame) {
  if (frame.frame_type == AMQP_FRAME_METHOD) {
    on_method(frame.payload.method, frame.channel);
    return;
  }
  const auto found = channels_.find(frame.channel);
  if (found == channels_.end() || !found->second) return;
  const std::shared_ptr<Inlet> inlet = found->second;
  std::optional<Arrived> complete;
  if (frame.frame_type == AMQP_FRAME_HEADER) {
    complete = inlet->assembly.header(frame, inlet->resent);
  } else if (frame.frame_type == AMQP_FRAME_BODY) {
    complete = inlet->assembly.body(frame.payload.body_fragment);
  }
  if (complete) on_arrived(inlet, std::move(*complete));
}

void ConsumeLink::on_arrived(const std::shared_ptr<Inlet>& inlet, Arrived arrived) {
  if (!arrived.redelivered && inlet->doubtful > 0) {
    --inlet->doubtful;
    arrived.redelivered = true;
  }
  if (inlet->assembly.hostile()) {
    logger.warn("queue {} held a message with too many headers; it is skipped", inlet->queue);
    meters_.skipped(reason::undecodable);
    inlet->window.skipped();
    if (!std::exchange(inlet->in_dirty, true)) dirty_.push_back(inlet);
    return;
  }
  if (!inlet->window.delivered(std::move(arrived))) throw LinkError("a delivery out of turn");
  make_ready(inlet);
}

void ConsumeLink::on_method(const amqp_method_t& method, amqp_channel_t channel) {
  if (method.id == AMQP_CONNECTION_CLOSE_METHOD) {
    throw LinkError("the server closed it: " + describe(*static_cast<const amqp_connection_close_t*>(method.decoded)));
  }
  const auto found = channels_.find(channel);
  if (found == channels_.end()) return;
  const std::shared_ptr<Inlet> inlet = found->second;  // null: we asked to close it
  switch (method.id) {
    case AMQP_BASIC_DELIVER_METHOD:
      if (inlet) inlet->assembly.begin(*static_cast<const amqp_basic_deliver_t*>(method.decoded));
      return;
    case AMQP_QUEUE_DECLARE_OK_METHOD:
      if (inlet && inlet->read_before) {
        inlet->doubtful = static_cast<const amqp_queue_declare_ok_t*>(method.decoded)->message_count;
      }
      return;
    case AMQP_BASIC_CONSUME_OK_METHOD:
      if (!inlet) return;
      inlet->phase = Inlet::Phase::active;
      inlet->read_before = true;
      inlet->retry_at.reset();
      inlet->backoff.reset();
      inlet->complaint.clear();
      return;
    case AMQP_CHANNEL_CLOSE_METHOD:
      wire_->send(channel, AMQP_CHANNEL_CLOSE_OK_METHOD, amqp_channel_close_ok_t{});
      if (inlet) on_channel_closed(inlet, *static_cast<const amqp_channel_close_t*>(method.decoded));
      channels_.erase(channel);
      return;
    case AMQP_CHANNEL_CLOSE_OK_METHOD:
      channels_.erase(channel);
      return;
    case AMQP_BASIC_CANCEL_METHOD:  // the queue was deleted
      if (!inlet) return;
      close_channel(*inlet);
      inlet->forget_channel();
      retry_later(*inlet);
      return;
    default:  // the other answers of open(): the last one, consume-ok, tells it all
      return;
  }
}

void ConsumeLink::retry_later(Inlet& inlet) {
  set_timer(inlet, clock_.now() + inlet.backoff.next());
}

void ConsumeLink::on_channel_closed(const std::shared_ptr<Inlet>& inlet, const amqp_channel_close_t& closed) {
  const bool was_active = inlet->phase == Inlet::Phase::active;
  inlet->forget_channel();
  retry_later(*inlet);
  const std::string why = describe(closed);
  const bool other_properties = closed.reply_code == AMQP_PRECONDITION_FAILED;
  constexpr std::uint16_t exchange_class = 40;
  constexpr std::uint16_t queue_class = 50;
  constexpr std::uint16_t basic_class = 60;
  std::string complaint;
  if (closed.reply_code == AMQP_ACCESS_REFUSED && closed.class_id == basic_class &&
      why.find("exclusive") != std::string::npos) {
    return;  // another reader has it: stand by
  }
  if (other_properties && closed.class_id == exchange_class && !inlet->passive_exchange) {
    inlet->passive_exchange = true;
    complaint = "exists with other properties; using it as it is: ";
  } else if (other_properties && closed.class_id == queue_class && !inlet->passive_queue) {
    inlet->passive_queue = true;
    complaint = "exists with other properties; using it as it is: ";
  } else if (closed.reply_code == AMQP_NOT_FOUND) {
    inlet->passive_exchange = inlet->passive_queue = false;
    complaint = "is gone; trying again: ";
  } else {
    complaint = was_active ? "was closed by the server; trying again: " : "cannot be read; trying again: ";
  }
  complaint += why;
  if (std::exchange(inlet->complaint, complaint) != complaint) logger.warn("queue {} {}", inlet->queue, complaint);
}

void ConsumeLink::close_channel(Inlet& inlet) {
  amqp_channel_close_t request{};
  request.reply_code = AMQP_REPLY_SUCCESS;
  wire_->send(inlet.channel, AMQP_CHANNEL_CLOSE_METHOD, request);
  channels_[inlet.channel] = nullptr;
}

/// The lowest number: the library keeps some 18 KB for each that was ever used.
amqp_channel_t ConsumeLink::free_channel() const {
  amqp_channel_t lowest = 1;
  for (const auto& [number, inlet] : channels_) {
    if (number != lowest) break;
    ++lowest;
  }
  return lowest;
}

void ConsumeLink::open(const std::shared_ptr<Inlet>& inlet) {
  const auto limit = static_cast<amqp_channel_t>(wire_->channel_limit());
  if (channels_.size() >= limit) {
    retry_later(*inlet);  // a channel that is being closed becomes free, or the keeper finds another connection
    return;
  }
  inlet->channel = free_channel();
  inlet->phase = Inlet::Phase::opening;
  set_timer(*inlet, clock_.now() + cluster_.rpc_timeout());
  channels_[inlet->channel] = inlet;
  wire_->send(inlet->channel, AMQP_CHANNEL_OPEN_METHOD, amqp_channel_open_t{});
  request_queue(*inlet);
  amqp_basic_qos_t qos{};
  qos.prefetch_count = std::max<std::uint16_t>(inlet->options.prefetch, 1);
  wire_->send(inlet->channel, AMQP_BASIC_QOS_METHOD, qos);
  amqp_basic_consume_t consume{};
  consume.queue = to_bytes(inlet->queue);
  const bool queue_decides = one_reader_by_queue(inlet->topic, cluster_.queue_type());
  consume.exclusive = inlet->options.exclusive && !queue_decides ? 1 : 0;
  wire_->send(inlet->channel, AMQP_BASIC_CONSUME_METHOD, consume);
}

void ConsumeLink::request_queue(const Inlet& inlet) {
  const std::string& exchange = exchange_of(inlet.topic);
  if (must_declare(inlet.topic)) {
    amqp_exchange_declare_t declare{};
    declare.exchange = to_bytes(exchange);
    declare.type = amqp_cstring_bytes("direct");
    declare.durable = inlet.topic.durable ? 1 : 0;
    declare.passive = inlet.passive_exchange ? 1 : 0;
    wire_->send(inlet.channel, AMQP_EXCHANGE_DECLARE_METHOD, declare);
  }
  QueueArguments arguments(inlet.topic, cluster_.queue_type(), inlet.options.exclusive);
  amqp_queue_declare_t queue{};
  queue.queue = to_bytes(inlet.queue);
  queue.durable = inlet.topic.durable ? 1 : 0;
  queue.passive = inlet.passive_queue ? 1 : 0;
  queue.arguments = arguments.table();
  wire_->send(inlet.channel, AMQP_QUEUE_DECLARE_METHOD, queue);
  amqp_queue_bind_t bind{};
  bind.queue = to_bytes(inlet.queue);
  bind.exchange = to_bytes(exchange);
  bind.routing_key = to_bytes(inlet.topic.name);
  wire_->send(inlet.channel, AMQP_QUEUE_BIND_METHOD, bind);
}

void ConsumeLink::set_timer(Inlet& inlet, config::Clock::Instant at) {
  inlet.retry_at = at;
  if (!next_timer_ || at < *next_timer_) next_timer_ = at;
}

void ConsumeLink::check_timers() {
  if (!next_timer_) return;
  const config::Clock::Instant now = clock_.now();
  if (*next_timer_ > now) return;
  next_timer_.reset();
  std::size_t opening = static_cast<std::size_t>(std::count_if(
      inlets_.begin(), inlets_.end(), [](const auto& inlet) { return inlet->phase == Inlet::Phase::opening; }));
  for (const auto& inlet : inlets_) {
    if (!inlet->retry_at) continue;
    const config::Clock::Instant at = *inlet->retry_at;
    if (at > now) {
      set_timer(*inlet, at);
      continue;
    }
    if (inlet->phase == Inlet::Phase::opening) throw LinkError("no answer to the request to read " + inlet->queue);
    if (inlet->phase == Inlet::Phase::idle && opening >= most_opening) {
      openers_wait_ = true;
      continue;
    }
    inlet->retry_at.reset();
    if (inlet->phase != Inlet::Phase::idle) continue;
    open(inlet);
    if (inlet->phase == Inlet::Phase::opening) ++opening;
  }
}

void ConsumeLink::send_settlements(Inlet& inlet, std::size_t patience) {
  for (const AckWindow::Action& action : inlet.window.take(patience)) {
    if (action.kind == AckWindow::Kind::acknowledge) {
      amqp_basic_ack_t ack{};
      ack.delivery_tag = action.tag;
      ack.multiple = action.multiple ? 1 : 0;
      wire_->send(inlet.channel, AMQP_BASIC_ACK_METHOD, ack);
    } else {
      amqp_basic_nack_t nack{};
      nack.delivery_tag = action.tag;
      nack.multiple = action.multiple ? 1 : 0;
      wire_->send(inlet.channel, AMQP_BASIC_NACK_METHOD, nack);
    }
  }
}

void ConsumeLink::send_all_settlements() {
  if (dirty_.empty()) return;
  settled_at_ = clock_.now();
  const std::vector<std::shared_ptr<Inlet>> dirty = std::exchange(dirty_, {});
  for (const auto& inlet : dirty) inlet->in_dirty = false;
  for (const auto& inlet : dirty) {
    if (inlet->closed || inlet->channel == 0) continue;
    send_settlements(*inlet, inlet->patience());
  }
}

}  // namespace iotcloud::brokers::rabbitmq
