#include "iotcloud/brokers/rabbitmq/publish_channel.h"

#include <algorithm>
#include <cstddef>
#include <utility>

#include <fmt/core.h>
#include <sys/socket.h>

#include "iotcloud/brokers/rabbitmq/wire/declarations.h"
#include <iotcloud/brokers/rabbitmq/logger.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

// The most messages that the channel's thread sends before it reads again.
constexpr std::size_t sent_in_a_row = 256;
// After this many nacks in a row for one publisher's messages the client reconnects.
constexpr std::size_t nacks_of_stale_channel = 4;
constexpr std::chrono::minutes renewals_forgotten_after{1};
constexpr std::chrono::milliseconds longest_sleep{1000};

/// Whether the server will never accept a message for which it closed the channel: the message is too large (311; 406
/// for a limit set on the server). A missing permission (403) or exchange (404), or a lock (405), may be temporary.
/// https://www.rabbitmq.com/amqp-0-9-1-reference.html#constants
bool is_final(int reply_code) {
  return reply_code == AMQP_CONTENT_TOO_LARGE || reply_code == AMQP_PRECONDITION_FAILED;
}

}  // namespace

PublishChannel::PublishChannel(const Cluster& cluster, const char* purpose, Meters& meters, const config::Clock& clock,
                               ConnectionLog& log)
    : cluster_(cluster),
      purpose_(purpose),
      clock_(clock),
      core_(*this, meters, clock),
      answers_(cluster.confirm_timeout()),
      burst_target_(std::make_shared<client::Burst::Target>([this] {
        const config::MutexLock lock(core_.mutex);
        push();
      })),
      life_("amqp-publish", *this, core_.mutex, sleep_, cluster, clock, log) {
  const config::MutexLock lock(core_.mutex);
  life_.start();
}

PublishChannel::~PublishChannel() {
  burst_target_->close();
  {
    const config::MutexLock lock(core_.mutex);
    life_.begin_to_end();
  }
  life_.join();
}

ConnectionState PublishChannel::state() const {
  const config::MutexLock lock(core_.mutex);
  if (life_.ending()) return ConnectionState::closed;
  if (!wire_) return ConnectionState::connecting;
  return blocked_ ? ConnectionState::blocked : ConnectionState::connected;
}

void PublishChannel::watch() {
  const config::MutexLock lock(core_.mutex);
  if (!core_.turn_taken() || !wire_) return;
  if (stalls_.stalls(core_.turns(), wire_->descriptor(), clock_.now(), cluster_.rpc_timeout())) {
    ::shutdown(wire_->descriptor(), SHUT_RDWR);  // makes the stuck send fail
  }
}

void PublishChannel::added(const std::shared_ptr<Outbox>& outbox) {
  if (!wire_) return;
  undeclared_.push_back(outbox);
  wake();
}

client::PublishTransport::Room PublishChannel::room(const std::shared_ptr<Outbox>& /*outbox*/, const Message& next,
                                                    bool /*alone*/) {
  if (!wire_ || blocked_ || life_.moving() || life_.broken()) return Room::full;
  return std::exchange(writable_, false) || wire_->room_for(next.payload.size()) ? Room::yes : Room::full;
}

void PublishChannel::send(UnderWay& message) {
  give_tag(message);
  const Instant now = clock_.now();
  const config::Unlocked unlocked(core_.mutex);
  put(message, now);
}

void PublishChannel::send_alone(UnderWay& message) {
  // A sleeping channel's thread need not wake up for the answer at once.
  if (life_.sleeps() && tags_.empty()) sleep_.put_off(gathering_time);
  give_tag(message);
  const Instant now = clock_.now();
  client::Burst* const burst = client::Burst::going_on();
  bool held_back = false;
  {
    const config::Unlocked unlocked(core_.mutex);
    put(message, now);
    held_back = wire_->flush(burst != nullptr);
  }
  if (held_back && !held_back_) burst->remember(burst_target_);
  held_back_ = held_back;
  if (wire_->has_buffered()) wake();
}

void PublishChannel::send_gathered() {
  {
    const config::Unlocked unlocked(core_.mutex);
    wire_->flush(false);
  }
  held_back_ = false;
  if (wire_->has_buffered()) wake();
}

void PublishChannel::give_tag(UnderWay& message) {
  tags_.push_back(&message);
  // With this many unanswered messages the channel's thread must watch the socket: wake it, so that it does.
  if (tags_.size() == most_gathered) wake();
}

void PublishChannel::put(const UnderWay& message, Instant now) {
  const Outbox& outbox = *message.outbox;
  const client::AcceptedMessage& accepted = message.accepted;
  MessageProperties::SendOptions options;
  options.durable = outbox.topic.durable;
  options.resent = accepted.resent || accepted.old;
  options.priority = outbox.options.priority;
  options.origin = {outbox.id, accepted.number};
  if (outbox.options.deadline.count() > 0) {
    const auto left = accepted.accepted_at + outbox.options.deadline - now;
    options.expires_in = std::max(std::chrono::milliseconds(1), std::chrono::ceil<std::chrono::milliseconds>(left));
  }
  wire_->publish(publish_channel, exchange_of(outbox.topic), outbox.topic.name,
                 properties_.encode(accepted.message, options), accepted.message.payload.bytes());
}

// For a failed send, or if memory ran out in the middle of a frame.
void PublishChannel::broke(const char* /*why*/) noexcept {
  life_.broke();
}

void PublishChannel::left_waiting(const std::shared_ptr<Outbox>& /*outbox*/, Instant /*now*/) {
  wake();
}

void PublishChannel::want_answers() {
  push();
  if (tags_.empty() || std::exchange(answers_wanted_, true)) return;
  wake();
}

void PublishChannel::wake() noexcept {
  life_.wake();
}

void PublishChannel::push() {
  if (std::exchange(held_back_, false) && wire_) wire_->push();
}

ConnectionLife::Rest PublishChannel::rest() {
  core_.mutex.assert_held();
  ConnectionLife::Rest rest;
  rest.limit = time_to_sleep();
  rest.want_write = wire_ && !blocked_ && !life_.moving() && core_.has_waiting();
  if (tags_.empty()) answers_wanted_ = false;
  const bool gathering =
      wire_ && !tags_.empty() && tags_.size() < most_gathered && !answers_wanted_ && !core_.has_waiting();
  if (gathering) rest.limit = std::min(rest.limit, gathering_time);
  if (wire_ && !gathering) rest.socket = wire_->descriptor();
  return rest;
}

std::chrono::milliseconds PublishChannel::time_to_sleep() {
  using std::chrono::milliseconds;
  if (core_.fire_timers()) return milliseconds(0);
  // Do not sleep if other threads left work while this thread was awake: they do not wake it then.
  if (core_.report_due() || (wire_ && !undeclared_.empty())) return milliseconds(0);
  milliseconds limit = longest_sleep;
  if (core_.next_timer() != Instant::max()) {
    const auto left = std::chrono::ceil<milliseconds>(core_.next_timer() - clock_.now());
    limit = std::clamp(left, milliseconds(0), limit);
  }
  return wire_ ? std::min(limit, milliseconds(wire_->heartbeat()) / 2) : limit;
}

void PublishChannel::open(std::size_t server) {
  auto wire = cluster_.connect(server, purpose_, Login::writer);
  wire->open_channel(publish_channel);
  wire->select_confirms(publish_channel);
  spare_ = std::move(wire);
}

std::shared_ptr<ShownChain> PublishChannel::opened() {
  core_.mutex.assert_held();
  wire_ = std::move(spare_);
  blocked_ = writable_ = reading_return_ = false;
  declared_.clear();
  undeclared_ = core_.outboxes();
  return wire_->shown();
}

void PublishChannel::serve(ConnectionLife::Readiness ready) {
  core_.mutex.assert_held();
  {
    const PublishCore::Turn turn(core_);
    push();
    declare_topics();
    if (ready.readable || wire_->has_buffered()) {
      const config::Unlocked unlocked(core_.mutex);
      read_frames();
    }
    writable_ = ready.writable;
    core_.send_waiting(turn, sent_in_a_row);
    writable_ = false;
    while (wire_->has_buffered()) {  // because a send also reads when heartbeats are due
      const config::Unlocked unlocked(core_.mutex);
      read_frames();
    }
  }
  check_answers();
}

void PublishChannel::call_back() {
  core_.mutex.assert_held();
  core_.report();
}

bool PublishChannel::idle() const {
  core_.mutex.assert_held();
  return tags_.empty();
}

void PublishChannel::forget() {
  core_.mutex.assert_held();
  const PublishCore::Turn turn(core_);
  blocked_ = held_back_ = false;
  spare_ = std::move(wire_);
  undeclared_.clear();
  forget_channel(false);
}

void PublishChannel::close(bool in_order) noexcept {
  if (in_order) spare_->close(publish_channel);
  spare_.reset();
}

void PublishChannel::forget_channel(bool one_by_one) {
  core_.connection_lost(one_by_one);
  tags_.clear();
  first_tag_ = 1;
  answers_.rest(clock_.now());
}

void PublishChannel::check_answers() {
  const Instant now = clock_.now();
  if (tags_.empty() || blocked_) return answers_.rest(now);
  const auto overdue = answers_.overdue(first_tag_, now);
  if (!overdue) return;
  throw LinkError(fmt::format("it confirmed nothing of topic {} for {} s; what has no answer is sent again",
                              tags_.front()->outbox->topic.name, overdue->count() / 1000));
}

void PublishChannel::declare_topics() {
  while (!undeclared_.empty()) {
    const std::shared_ptr<Outbox> outbox = undeclared_.back();
    undeclared_.pop_back();
    if (outbox->closed) continue;
    const std::pair<std::string, bool> exchange(exchange_of(outbox->topic), outbox->topic.durable);
    if (must_declare(outbox->topic) && declared_.insert(exchange).second) {
      const config::Unlocked unlocked(core_.mutex);
      const std::string why = wire_->declare_exchange(declare_channel, exchange.first, exchange.second);
      if (!why.empty()) {
        logger.error(
            "cannot declare the exchange {} ({}): {}; using it as it is. Delete it on the server, or set the "
            "channel's durability to what it was made with",
            exchange.first, exchange.second ? "durable" : "not durable", why);
      }
    }
    if (outbox->options.own_queue) {
      const config::Unlocked unlocked(core_.mutex);
      const std::string why =
          wire_->declare_queue(declare_channel, outbox->topic, outbox->options.original_queue, cluster_.queue_type());
      if (!why.empty()) {
        logger.error("cannot make the queue {} ({}): {}; what is sent waits here until it is there",
                     outbox->options.original_queue.empty() ? outbox->topic.name : outbox->options.original_queue,
                     outbox->topic.durable ? "durable" : "not durable", why);
      }
    }
    core_.open(outbox);
  }
}

void PublishChannel::read_frames() {
  do {
    const std::optional<amqp_frame_t> frame = wire_->next_frame();
    if (!frame) return;
    if (frame->frame_type == AMQP_FRAME_METHOD) {
      on_method(frame->payload.method, frame->channel);
    } else if (frame->frame_type == AMQP_FRAME_HEADER && reading_return_) {
      on_returned(*static_cast<const amqp_basic_properties_t*>(frame->payload.properties.decoded));
      reading_return_ = false;  // the returned body follows and is ignored, because the message is still here
    }
    wire_->release(frame->channel);
  } while (wire_->has_buffered());
}

/// Marks a returned message. Its confirmation is still to come, so it is among the first unanswered ones.
void PublishChannel::on_returned(const amqp_basic_properties_t& properties) {
  const std::optional<MessageOrigin> origin = origin_of(properties);
  const config::MutexLock lock(core_.mutex);
  const auto found = std::find_if(tags_.begin(), tags_.end(), [&](const UnderWay* message) {
    return message != nullptr && MessageOrigin{message->outbox->id, message->accepted.number} == origin;
  });
  if (found != tags_.end()) (*found)->returned = true;
}

void PublishChannel::on_method(const amqp_method_t& method, amqp_channel_t channel) {
  switch (method.id) {
    case AMQP_BASIC_ACK_METHOD: {
      const auto& ack = *static_cast<const amqp_basic_ack_t*>(method.decoded);
      on_answer(ack.delivery_tag, ack.multiple != 0, true);
      return;
    }
    case AMQP_BASIC_NACK_METHOD: {
      const auto& nack = *static_cast<const amqp_basic_nack_t*>(method.decoded);
      on_answer(nack.delivery_tag, nack.multiple != 0, false);
      return;
    }
    case AMQP_BASIC_RETURN_METHOD:
      reading_return_ = true;
      return;
    case AMQP_CHANNEL_CLOSE_METHOD:
      wire_->send(channel, AMQP_CHANNEL_CLOSE_OK_METHOD, amqp_channel_close_ok_t{});
      if (channel == publish_channel) {
        on_channel_closed(*static_cast<const amqp_channel_close_t*>(method.decoded));
      }
      return;
    case AMQP_CONNECTION_CLOSE_METHOD:
      throw LinkError("the server closed it: " +
                      describe(*static_cast<const amqp_connection_close_t*>(method.decoded)));
    case AMQP_CONNECTION_BLOCKED_METHOD: {
      const auto& blocked = *static_cast<const amqp_connection_blocked_t*>(method.decoded);
      logger.warn("the server takes no messages for now: {}", to_string(blocked.reason));
      const config::MutexLock lock(core_.mutex);
      blocked_ = true;
      return;
    }
    case AMQP_CONNECTION_UNBLOCKED_METHOD: {
      logger.info("the server takes messages again");
      const config::MutexLock lock(core_.mutex);
      blocked_ = false;
      return;
    }
    default:
      return;
  }
}

void PublishChannel::on_answer(std::uint64_t tag, bool multiple, bool good) {
  const config::MutexLock lock(core_.mutex);
  if (tag < first_tag_ || tag >= first_tag_ + tags_.size()) {
    if (tag != 0 || !multiple) return;  // tag 0 with `multiple` means all messages so far
    tag = first_tag_ + tags_.size() - 1;
  }
  for (std::uint64_t i = multiple ? first_tag_ : tag; i <= tag && !tags_.empty(); ++i) {
    UnderWay* const message = std::exchange(tags_[i - first_tag_], nullptr);
    if (message != nullptr) answered(*message, good);
  }
  while (!tags_.empty() && tags_.front() == nullptr) {
    tags_.pop_front();
    ++first_tag_;
  }
  if (std::exchange(stale_, false)) throw LinkError("it stores no messages in a queue (nack) on this connection");
}

void PublishChannel::answered(UnderWay& message, bool good) {
  const std::shared_ptr<Outbox> outbox = message.outbox;
  if (!good) {
    core_.put_off(message);
    const Instant now = clock_.now();
    // A channel that published while a quorum queue had no leader may never learn of the new one.
    if (outbox->put_off_in_row() >= nacks_of_stale_channel && now >= next_renewal_) {
      if (now > next_renewal_ + renewals_forgotten_after) renewals_.reset();
      next_renewal_ = now + renewals_.next();
      stale_ = true;
    }
  } else if (message.returned) {
    core_.returned(message);
    if (outbox->options.own_queue && std::exchange(outbox->ready, false)) {
      undeclared_.push_back(outbox);  // its own queue was deleted: declare it again
    }
  } else {
    core_.confirmed(message);
  }
}

void PublishChannel::on_channel_closed(const amqp_channel_close_t& closed) {
  const std::string why = describe(closed);
  {
    const config::MutexLock lock(core_.mutex);
    UnderWay* const only = core_.the_only_one();
    if (only != nullptr && is_final(closed.reply_code)) {
      logger.error("the server refused a message for topic {}: {}", only->outbox->topic.name, why);
      core_.refused(*only, why);
    } else if (only != nullptr && (closed.reply_code != AMQP_NOT_FOUND || only->accepted.resent)) {
      // Otherwise the exchange was deleted: declare it again and send the message at once.
      core_.refused_for_now(*only, why);
    }
    forget_channel(true);
    declared_.clear();
    undeclared_ = core_.outboxes();  // declare everything again, because an exchange may have been deleted
  }
  wire_->open_channel(publish_channel);
  wire_->select_confirms(publish_channel);
}

}  // namespace iotcloud::brokers::rabbitmq
