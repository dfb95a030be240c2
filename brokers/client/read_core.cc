#include "iotcloud/brokers/client/read_core.h"

#include <algorithm>
#include <exception>
#include <utility>

#include <iotcloud/brokers/logger.h>

namespace iotcloud::brokers::client {

ReadCore::ReadCore(ReadTransport& transport, Meters& meters, const config::Clock& clock,
                   std::chrono::milliseconds gathering_time)
    : transport_(transport), meters_(meters), clock_(clock), gathering_time_(gathering_time) {}

void ReadCore::settle(Inbox& inbox, std::uint64_t public_tag, Settlement settlement) noexcept {
  constexpr std::uint64_t tag_mask = (std::uint64_t{1} << 48U) - 1;
  const std::uint64_t tag = public_tag & tag_mask;
  if (public_tag != inbox.public_tag(tag) || !inbox.subscriber || inbox.subscriber->closed) return;
  if (!inbox.window.settle(tag, settlement)) return;
  if (settlement == Settlement::retry) {
    make_ready(inbox);
    transport_.wake();
  } else {
    transport_.settled(inbox, make_dirty(inbox));
  }
}

void ReadCore::resume(Inbox& inbox) {
  if (inbox.subscriber) inbox.subscriber->paused = false;
  make_ready(inbox);
  transport_.wake();
}

void ReadCore::await_handler(const Subscriber& subscriber) {
  if (hands_on_here()) return;
  while (subscriber.running) handler_ended_.wait(mutex);
}

void ReadCore::await_handlers(const std::vector<std::shared_ptr<Inbox>>& inboxes, config::Clock::Instant end) {
  const auto runs = [](const std::shared_ptr<Inbox>& inbox) { return inbox->running; };
  while (std::any_of(inboxes.begin(), inboxes.end(), runs)) {
    if (handler_ended_.wait_until(mutex, clock_, end) == std::cv_status::timeout) return;
  }
}

bool ReadCore::arrived(Inbox& inbox, Arrived arrived) {
  if (!inbox.window.delivered(std::move(arrived))) return false;
  make_ready(inbox);
  return true;
}

void ReadCore::skipped(Inbox& inbox) {
  inbox.window.skipped();
  make_dirty(inbox);
}

void ReadCore::make_ready(Inbox& inbox) {
  if (inbox.in_ready || !inbox.has_work()) return;
  inbox.in_ready = true;
  ready_.push_back(inbox.shared_from_this());
}

bool ReadCore::make_dirty(Inbox& inbox) {
  if (inbox.in_dirty) return false;
  inbox.in_dirty = true;
  dirty_.push_back(inbox.shared_from_this());
  return true;
}

void ReadCore::accept(Inbox& inbox, std::uint64_t tag) {
  inbox.window.settle(tag, Settlement::accept);
  transport_.settled(inbox, make_dirty(inbox));
}

void ReadCore::conflate(Inbox& inbox) {
  const std::size_t newest = inbox.subscriber->options.keep_last;
  while (newest > 0 && inbox.window.waiting() > newest) {
    accept(inbox, inbox.window.next().tag);
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

Inbox* ReadCore::take(Turn& turn) {
  while (has_ready()) {
    std::shared_ptr<Inbox> inbox = std::move(ready_.front());
    ready_.pop_front();
    inbox->in_ready = false;
    if (!inbox->has_work()) continue;
    const bool again = inbox->more && transport_.fetch(*inbox);
    if (inbox->window.waiting() == 0 || inbox->subscriber->paused) {
      if (again) make_ready(*inbox);
      continue;
    }
    conflate(*inbox);
    turn.arrived_ = inbox->window.next();
    meters_.received(turn.arrived_.redelivered);
    turn.public_tag_ = inbox->public_tag(turn.arrived_.tag);
    if (inbox->subscriber->options.automatic_ack) accept(*inbox, turn.arrived_.tag);
    make_ready(*inbox);  // the inboxes take turns
    turn.subscriber_ = inbox->subscriber;
    turn.subscriber_->running = inbox->running = true;
    turn.inbox_ = std::move(inbox);
    return turn.inbox_.get();
  }
  return nullptr;
}

void ReadCore::run(Turn& turn) {
  {
    const config::Unlocked unlocked(mutex);
    std::shared_ptr<Settler> settler;
    if (!turn.subscriber_->options.automatic_ack) settler = turn.inbox_;
    call(*turn.subscriber_, std::move(turn.arrived_), std::move(settler), turn.public_tag_);
  }
  turn.subscriber_->running = turn.inbox_->running = false;
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
  return std::any_of(dirty_.begin(), dirty_.end(), [](const std::shared_ptr<Inbox>& inbox) {
    return inbox->subscriber && inbox->window.settled() > inbox->patience();
  });
}

std::vector<std::shared_ptr<Inbox>> ReadCore::take_dirty() {
  if (dirty_.empty()) return {};
  told_at_ = clock_.now();
  std::vector<std::shared_ptr<Inbox>> dirty = std::exchange(dirty_, {});
  for (const auto& inbox : dirty) inbox->in_dirty = false;
  return dirty;
}

void ReadCore::take_dirty(Inbox& inbox) {
  if (!std::exchange(inbox.in_dirty, false)) return;
  std::erase_if(dirty_, [&](const std::shared_ptr<Inbox>& one) { return one.get() == &inbox; });
}

void ReadCore::forget(Inbox& inbox) {
  const auto is_it = [&](const std::shared_ptr<Inbox>& one) { return one.get() == &inbox; };
  std::erase_if(ready_, is_it);
  std::erase_if(dirty_, is_it);
  inbox.in_ready = inbox.in_dirty = false;
}

void ReadCore::connection_lost() {
  for (const auto& inbox : ready_) inbox->in_ready = false;
  ready_.clear();
  for (const auto& inbox : dirty_) inbox->in_dirty = false;
  dirty_.clear();
}

void ReadCore::stop() {
  stopped_ = true;
  while (hands_on()) handler_ended_.wait(mutex);
}

}  // namespace iotcloud::brokers::client
