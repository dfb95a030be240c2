// What the publishing link's own thread does: connect, read answers, keep the connection alive, clean up.
#include <algorithm>
#include <exception>
#include <utility>

#include <fmt/core.h>

#include "iotcloud/brokers/rabbitmq/publishing/publish_link.h"
#include "iotcloud/brokers/rabbitmq/wire/declarations.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

const config::Logger logger{"brokers.rabbitmq"};

constexpr std::size_t batch = 256;
// Answers to what was sent are awaited so long before the connection moves to the preferred server.
constexpr std::chrono::seconds moving_patience{2};
constexpr std::chrono::milliseconds moving_period{50};
// The patience with unanswered messages grows to so many doublings of the time-out.
constexpr unsigned most_doublings = 3;
constexpr std::chrono::minutes long_ago{1};

}  // namespace

void PublishLink::run() {
  bool readable = true;
  bool writable = false;
  for (;;) {
    try {
      if (!wire_) connect();
      if (wire_) serve(readable, writable);
      if (wire_) check_answers();
      if (wire_) move_back();
    } catch (const std::exception& error) {  // LinkError, or memory that ran out: both end this connection
      lose(error.what());
    }
    Lock lock(mutex_);
    reporter_.report_all(lock);
    if (closing_) break;
    std::chrono::milliseconds limit = time_to_sleep(clock_.now());
    // What came up while this thread was awake did not wake it.
    const bool undeclared = connected_ && !undeclared_.empty();
    if (reporter_.due() || wire_broken_ || undeclared) limit = std::chrono::milliseconds(0);
    if (!connected_)
      limit = std::clamp(std::chrono::ceil<std::chrono::milliseconds>(servers_.next_attempt() - clock_.now()),
                         std::chrono::milliseconds(0), limit);
    if (moving_since_) limit = std::min(limit, moving_period);
    const bool want_write =
        connected_ && !blocked_ && !moving_since_ && !runnable_.empty() && (one_by_one_ == 0 || under_way_.empty());
    if (under_way_.empty()) answers_wanted_ = false;
    const bool gathering =
        connected_ && !under_way_.empty() && under_way_.size() < most_gathered && !answers_wanted_ && runnable_.empty();
    if (gathering) limit = std::min(limit, gathering_time);
    sleep_.watch(connected_ && !gathering ? wire_->descriptor() : -1, want_write);
    sleeping_ = true;
    lock.unlock();
    const LinkSleep::Result woken = sleep_.wait(limit);
    lock.lock();
    sleeping_ = false;
    writable = woken.writable;
    readable = woken.readable || !woken.writable;  // after a time-out too: heartbeats
  }
  Lock lock(mutex_);
  const std::unique_ptr<AmqpLink> wire = give_up_wire(lock);
  lock.unlock();
  if (wire) wire->close(publish_channel);
}

void PublishLink::connect() {
  Lock lock(mutex_);
  const std::optional<std::size_t> server = servers_.due(clock_.now());
  if (!server) return;
  lock.unlock();
  std::unique_ptr<AmqpLink> wire;
  try {
    wire = cluster_.connect(*server, purpose_);
    wire->open_channel(publish_channel);
    wire->select_confirms(publish_channel);
  } catch (const LinkError& error) {
    log_.failed(cluster_.name(*server), error.what());
    lock.lock();
    servers_.failed(*server, clock_.now());
    return;
  }
  log_.connected(cluster_.name(*server));
  lock.lock();
  servers_.connected(*server, clock_.now());
  wire_ = std::move(wire);
  connected_ = true;
  blocked_ = wire_broken_ = false;
  reading_return_ = false;
  first_tag_ = 1;
  awaited_tag_ = 0;
  declared_.clear();
  undeclared_ = outboxes_;
}

void PublishLink::serve(bool readable, bool writable) {
  Lock lock(mutex_);
  acquire_wire(lock);
  if (wire_broken_) {
    release_wire();
    throw LinkError("a send failed");
  }
  try {
    push_held_back();
    declare_topics(lock);
    lock.unlock();
    if (readable || wire_->has_buffered()) read_frames();
    lock.lock();
    send_waiting(lock, batch, writable);
    while (wire_->has_buffered()) {  // a send reads too when heartbeats are due
      lock.unlock();
      read_frames();
      lock.lock();
    }
  } catch (...) {
    if (!lock.owns_lock()) lock.lock();
    release_wire();
    throw;
  }
  release_wire();
}

std::unique_ptr<AmqpLink> PublishLink::give_up_wire(Lock& lock) {
  acquire_wire(lock);
  std::unique_ptr<AmqpLink> wire = std::move(wire_);
  connected_ = blocked_ = wire_broken_ = held_back_ = false;
  release_wire();
  return wire;
}

void PublishLink::forget_connection() {
  moving_since_.reset();
  requeue_under_way();
  one_by_one_ = 0;
  for (const auto& outbox : runnable_) outbox->in_runnable = false;
  runnable_.clear();
  undeclared_.clear();
  for (const auto& outbox : outboxes_) outbox->disconnected();
}

void PublishLink::lose(const std::string& reason) {
  Lock lock(mutex_);
  if (servers_.current()) log_.lost(cluster_.name(*servers_.current()), reason);
  servers_.lost(clock_.now());
  give_up_wire(lock).reset();
  forget_connection();
}

void PublishLink::move_back() {
  Lock lock(mutex_);
  const Instant now = clock_.now();
  if (!moving_since_) {
    if (!servers_.must_move_back(now)) return;
    moving_since_ = now;
  }
  if (!under_way_.empty() && now - *moving_since_ < moving_patience) return;
  logger.info("{} answers again: going back to it", cluster_.name(client::ServerList::preferred));
  const std::unique_ptr<AmqpLink> wire = give_up_wire(lock);
  servers_.left();
  forget_connection();
  lock.unlock();
  if (wire) wire->close(publish_channel);
}

void PublishLink::check_answers() {
  const Lock lock(mutex_);
  const Instant now = clock_.now();
  if (under_way_.empty() || blocked_ || awaited_tag_ != first_tag_) {
    awaited_tag_ = first_tag_;
    awaited_since_ = now;
    if (now - unanswered_at_ > long_ago) unanswered_ = 0;
    return;
  }
  // It may also be the server's trouble, which more connections do not cure: ever more patience.
  const std::chrono::milliseconds patience = cluster_.confirm_timeout() * (1U << std::min(unanswered_, most_doublings));
  if (now - awaited_since_ < patience) return;
  ++unanswered_;
  unanswered_at_ = now;
  throw LinkError(fmt::format("it confirmed nothing of topic {} for {} s; what has no answer is sent again",
                              under_way_.front().outbox->topic.name, patience.count() / 1000));
}

void PublishLink::declare_topics(Lock& lock) {
  while (!undeclared_.empty()) {
    const std::shared_ptr<Outbox> outbox = undeclared_.back();
    undeclared_.pop_back();
    const std::pair<std::string, bool> exchange(exchange_of(outbox->topic), outbox->topic.durable);
    if (must_declare(outbox->topic) && declared_.insert(exchange).second) {
      lock.unlock();
      const std::string why = wire_->declare_exchange(declare_channel, exchange.first, exchange.second);
      lock.lock();
      if (!why.empty()) {
        logger.error(
            "cannot declare the exchange {} ({}): {}; using it as it is. Delete it on the server, or set the "
            "channel's durability to what it was made with",
            exchange.first, exchange.second ? "durable" : "not durable", why);
      }
    }
    if (outbox->options.own_queue) {
      lock.unlock();
      const std::string why = wire_->declare_queue(declare_channel, outbox->topic, cluster_.queue_type());
      lock.lock();
      if (!why.empty()) {
        logger.error("cannot make the queue {} ({}): {}; what is sent waits here until it is there", outbox->topic.name,
                     outbox->topic.durable ? "durable" : "not durable", why);
      }
    }
    outbox->ready = true;
    make_runnable(outbox);
  }
}

void PublishLink::read_frames() {
  do {
    const std::optional<amqp_frame_t> frame = wire_->next_frame();
    if (!frame) return;
    if (frame->frame_type == AMQP_FRAME_METHOD) {
      on_method(frame->payload.method, frame->channel);
    } else if (frame->frame_type == AMQP_FRAME_HEADER && reading_return_) {
      on_returned(*static_cast<const amqp_basic_properties_t*>(frame->payload.properties.decoded));
      reading_return_ = false;  // its body follows and is of no interest: we still have the message
    }
    wire_->release(frame->channel);
  } while (wire_->has_buffered());
}

/// Its confirmation is still to come, so it is among the first of those that have no answer.
void PublishLink::on_returned(const amqp_basic_properties_t& properties) {
  const std::optional<Origin> origin = origin_of(properties);
  const Lock lock(mutex_);
  const auto found = std::find_if(under_way_.begin(), under_way_.end(), [&](const UnderWay& entry) {
    return Origin{entry.outbox->id, entry.outgoing.number} == origin;
  });
  if (found != under_way_.end()) found->returned = true;
}

void PublishLink::on_method(const amqp_method_t& method, amqp_channel_t channel) {
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
      const Lock lock(mutex_);
      blocked_ = true;
      return;
    }
    case AMQP_CONNECTION_UNBLOCKED_METHOD: {
      logger.info("the server takes messages again");
      const Lock lock(mutex_);
      blocked_ = false;
      return;
    }
    default:
      return;
  }
}

void PublishLink::on_channel_closed(const amqp_channel_close_t& closed) {
  const std::string why = describe(closed);
  {
    const Lock lock(mutex_);
    const bool alone = under_way_.size() == 1 && !under_way_.front().outbox->closed;
    if (alone && (closed.reply_code != AMQP_NOT_FOUND || under_way_.front().outgoing.resent)) {
      // It is the one that the server does not want, and not for an exchange that we can declare again.
      under_way_.front().answered = true;
      under_way_.front().outbox->refused(under_way_.front().outgoing.number, why);
      note(under_way_.front().outbox);
    }
    logger.error("the server refused a message: {}", why);
    one_by_one_ = under_way_.size();
    requeue_under_way();
    declared_.clear();
    undeclared_ = outboxes_;  // perhaps the exchange was deleted
    for (const auto& outbox : runnable_) outbox->in_runnable = false;
    runnable_.clear();
    for (const auto& outbox : outboxes_) outbox->disconnected();
    first_tag_ = 1;
    awaited_tag_ = 0;
  }
  wire_->open_channel(publish_channel);
  wire_->select_confirms(publish_channel);
}

}  // namespace iotcloud::brokers::rabbitmq
