#include "iotcloud/brokers/client/read_core.h"

#include <algorithm>
#include <exception>
#include <utility>

#include <iotcloud/brokers/logger.h>

namespace iotcloud::brokers::client {

ReadCore::ReadCore(ReadTransport& transport, Meters& meters, const config::Clock& clock,
                   std::chrono::milliseconds gathering_time)
    : transport_(transport), meters_(meters), clock_(clock), gathering_time_(gathering_time) {}

void ReadCore::settle(DeliveryStream& stream, std::uint64_t public_tag, Settlement settlement) noexcept {
  constexpr std::uint64_t tag_mask = (std::uint64_t{1} << 48U) - 1;
  const std::uint64_t tag = public_tag & tag_mask;
  if (public_tag != stream.public_tag(tag) || !stream.subscriber || stream.subscriber->closed) return;
  if (!stream.window.settle(tag, settlement)) return;
  if (settlement == Settlement::retry) {
    make_ready(stream);
    transport_.wake();
  } else {
    transport_.settled(stream, make_dirty(stream));
  }
}

void ReadCore::resume(DeliveryStream& stream) {
  if (stream.subscriber) stream.subscriber->paused = false;
  make_ready(stream);
  transport_.wake();
}

void ReadCore::await_handler(const Subscriber& subscriber) {
  if (hands_on_here()) return;
  while (subscriber.running) handler_ended_.wait(mutex);
}

void ReadCore::await_handlers(const std::vector<std::shared_ptr<DeliveryStream>>& streams, config::Clock::Instant end) {
  const auto runs = [](const std::shared_ptr<DeliveryStream>& stream) { return stream->running; };
  while (std::any_of(streams.begin(), streams.end(), runs)) {
    if (handler_ended_.wait_until(mutex, clock_, end) == std::cv_status::timeout) return;
  }
}

bool ReadCore::arrived(DeliveryStream& stream, Arrived arrived) {
  if (!stream.window.delivered(std::move(arrived))) return false;
  make_ready(stream);
  return true;
}

void ReadCore::skipped(DeliveryStream& stream) {
  stream.window.skipped();
  make_dirty(stream);
}

void ReadCore::make_ready(DeliveryStream& stream) {
  if (stream.in_ready || !stream.has_work()) return;
  stream.in_ready = true;
  ready_.push_back(stream.shared_from_this());
}

bool ReadCore::make_dirty(DeliveryStream& stream) {
  if (stream.in_dirty) return false;
  stream.in_dirty = true;
  dirty_.push_back(stream.shared_from_this());
  return true;
}

void ReadCore::accept(DeliveryStream& stream, std::uint64_t tag) {
  stream.window.settle(tag, Settlement::accept);
  transport_.settled(stream, make_dirty(stream));
}

void ReadCore::conflate(DeliveryStream& stream) {
  const std::size_t newest = stream.subscriber->options.keep_last;
  while (newest > 0 && stream.window.waiting() > newest) {
    accept(stream, stream.window.next().tag);
    meters_.conflated();
  }
}

ReadCore::Turn::Turn(ReadCore& core) : core_(core), mine_(!core.hands_on()) {
  if (mine_) core_.hands_on_ = std::this_thread::get_id();
}

ReadCore::Turn::~Turn() {
  if (!mine_) return;
  core_.hands_on_ = {};
  core_.handler_ended_.notify_all();
}

DeliveryStream* ReadCore::take(Turn& turn) {
  while (has_ready()) {
    std::shared_ptr<DeliveryStream> stream = std::move(ready_.front());
    ready_.pop_front();
    stream->in_ready = false;
    if (!stream->has_work()) continue;
    const bool again = stream->more && transport_.fetch(*stream);
    if (stream->window.waiting() == 0 || stream->subscriber->paused) {
      if (again) make_ready(*stream);
      continue;
    }
    conflate(*stream);
    turn.arrived_ = stream->window.next();
    meters_.received(turn.arrived_.redelivered);
    turn.public_tag_ = stream->public_tag(turn.arrived_.tag);
    if (stream->subscriber->options.automatic_ack) accept(*stream, turn.arrived_.tag);
    make_ready(*stream);  // the streams take turns
    turn.subscriber_ = stream->subscriber;
    turn.subscriber_->running = stream->running = true;
    turn.stream_ = std::move(stream);
    return turn.stream_.get();
  }
  return nullptr;
}

void ReadCore::run(Turn& turn) {
  {
    const config::Unlocked unlocked(mutex);
    std::shared_ptr<Settler> settler;
    if (!turn.subscriber_->options.automatic_ack) settler = turn.stream_;
    call(*turn.subscriber_, std::move(turn.arrived_), std::move(settler), turn.public_tag_);
  }
  turn.subscriber_->running = turn.stream_->running = false;
  handler_ended_.notify_all();
}

void ReadCore::call(const Subscriber& subscriber, Arrived arrived, std::shared_ptr<Settler> settler,
                    std::uint64_t tag) {
  try {
    Delivery delivery(std::move(arrived.message), arrived.redelivered, std::move(settler), tag);
    delivery.tries = arrived.tries;
    subscriber.handler(std::move(delivery));
  } catch (const std::exception& error) {
    logger.error("the handler of topic {} threw: {}; the message is delivered again", subscriber.topic.name,
                 error.what());
  } catch (...) {
    logger.error("the handler of topic {} threw; the message is delivered again", subscriber.topic.name);
  }
}

bool ReadCore::settlements_due() const {
  if (dirty_.empty()) return false;
  if (gathered_at() <= clock_.now()) return true;
  return std::any_of(dirty_.begin(), dirty_.end(), [](const std::shared_ptr<DeliveryStream>& stream) {
    return stream->subscriber && stream->window.settled() > stream->patience();
  });
}

std::vector<std::shared_ptr<DeliveryStream>> ReadCore::take_dirty() {
  if (dirty_.empty()) return {};
  told_at_ = clock_.now();
  std::vector<std::shared_ptr<DeliveryStream>> dirty = std::exchange(dirty_, {});
  for (const auto& stream : dirty) stream->in_dirty = false;
  return dirty;
}

void ReadCore::take_dirty(DeliveryStream& stream) {
  if (!std::exchange(stream.in_dirty, false)) return;
  std::erase_if(dirty_, [&](const std::shared_ptr<DeliveryStream>& one) { return one.get() == &stream; });
}

void ReadCore::forget(DeliveryStream& stream) {
  const auto is_it = [&](const std::shared_ptr<DeliveryStream>& one) { return one.get() == &stream; };
  std::erase_if(ready_, is_it);
  std::erase_if(dirty_, is_it);
  stream.in_ready = stream.in_dirty = false;
}

void ReadCore::connection_lost() {
  for (const auto& stream : ready_) stream->in_ready = false;
  ready_.clear();
  for (const auto& stream : dirty_) stream->in_dirty = false;
  dirty_.clear();
}

void ReadCore::stop() {
  stopped_ = true;
  while (hands_on()) handler_ended_.wait(mutex);
}

}  // namespace iotcloud::brokers::client
