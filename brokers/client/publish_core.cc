#include "iotcloud/brokers/client/publish_core.h"

#include <exception>
#include <thread>
#include <utility>

#include "iotcloud/brokers/limits.h"
#include <iotcloud/brokers/logger.h>

namespace iotcloud::brokers::client {
namespace {

// The most messages of other publishers that a caller of publish() sends after its own.
constexpr std::size_t helping = 16;
// The number of unused UnderWay nodes that are kept for later messages.
constexpr std::size_t most_spare = 4096;

}  // namespace

PublishCore::PublishCore(PublishTransport& transport, Meters& meters, const config::Clock& clock)
    : transport_(transport), meters_(meters), clock_(clock) {}

std::shared_ptr<Outbox> PublishCore::add(const Topic& topic, const PublisherOptions& options) {
  std::shared_ptr<Outbox> outbox = transport_.make_outbox(topic, options);
  const config::MutexLock lock(mutex);
  outbox->lane = &lane_;
  outboxes_.push_back(outbox);
  transport_.added(outbox);
  return outbox;
}

void PublishCore::remove(const std::shared_ptr<Outbox>& outbox) {
  const config::MutexLock lock(mutex);
  std::vector<std::uint64_t> numbers;
  for (const UnderWay& message : under_way_) {
    if (message.outbox == outbox) numbers.push_back(message.accepted.number);
  }
  outbox->close(numbers);
  std::erase(outboxes_, outbox);
  // Called from inside the publisher's own callback, whose thread reports the rest.
  if (outbox->reporter == std::this_thread::get_id()) return;
  report(outbox);
}

Published PublishCore::publish(const std::shared_ptr<Outbox>& outbox, Message message, const Past& past) {
  const char* const why_not = refusal(message);
  const config::MutexLock lock(mutex);
  if (outbox->closed) return {PublishStatus::closed};
  const Instant now = clock_.now();
  if (why_not != nullptr) return refuse(outbox, std::move(message), now, why_not);
  outbox->expire(now);
  note(outbox);
  if (outbox->has_report()) transport_.wake();
  if (!outbox->has_room()) {
    outbox->refuse_room();
    transport_.want_answers();
    return {PublishStatus::would_block};
  }
  AcceptedMessage accepted = outbox->accept(std::move(message), now, past);
  const Published published{PublishStatus::accepted, accepted.number};
  if (!turn_taken_ && one_by_one_ == 0 && outbox->lane->runnable.empty() && outbox->idle() && outbox->may_send() &&
      send_alone(outbox, accepted)) {
    return published;
  }
  outbox->add_waiting(std::move(accepted));
  note(outbox);
  if (outbox->has_report()) transport_.wake();
  make_runnable(outbox);
  if (!outbox->in_runnable) {
    transport_.want_answers();
  } else if (turn_taken_) {
    left_for_turn_ = true;  // the thread that has the Turn looks again before it ends it
  } else {
    transport_.left_waiting(outbox, now);
  }
  return published;
}

Published PublishCore::refuse(const std::shared_ptr<Outbox>& outbox, Message message, Instant now, const char* why) {
  const AcceptedMessage refused = outbox->accept(std::move(message), now);
  outbox->sent_directly();
  outbox->refused(refused.number, why);
  note(outbox);
  transport_.wake();
  return {PublishStatus::accepted, refused.number};
}

bool PublishCore::send_alone(const std::shared_ptr<Outbox>& outbox, AcceptedMessage& accepted) {
  bool begun = false;
  try {
    if (transport_.room(outbox, accepted.message, true) != PublishTransport::Room::yes) return false;
    const Turn turn(*this);
    UnderWay& message = begin(outbox, std::move(accepted));
    begun = true;
    outbox->sent_directly();
    transport_.send_alone(message);
    if (left_for_turn_) {
      send_waiting(turn, helping);
      left_for_turn_ = true;  // messages may still be left for the transport's thread
    }
  } catch (const std::exception& error) {
    transport_.broke(error.what());
    return begun;
  }
  if (report_due()) transport_.wake();
  return true;
}

// NOLINTNEXTLINE(performance-unnecessary-value-param): a callback may destroy the publisher's own reference
bool PublishCore::drain(std::shared_ptr<Outbox> outbox, std::chrono::milliseconds limit) {
  const config::MutexLock lock(mutex);
  transport_.want_answers();
  const Instant end = clock_.now() + limit;
  while (outbox->pending() > 0) {
    if (outbox->has_report() && outbox->reporter == std::thread::id()) {
      report(outbox);
    } else if (changed_.wait_until(mutex, clock_, end) == std::cv_status::timeout) {
      return outbox->pending() == 0;
    }
  }
  return true;
}

std::size_t PublishCore::pending(const Outbox& outbox) const {
  const config::MutexLock lock(mutex);
  return outbox.pending();
}

std::optional<Instant> PublishCore::oldest(const Outbox& outbox) const {
  const config::MutexLock lock(mutex);
  std::optional<Instant> oldest;
  if (!outbox.idle()) oldest = outbox.next().accepted_at;
  for (const UnderWay& message : under_way_) {
    if (message.outbox.get() == &outbox && (!oldest || message.accepted.accepted_at < *oldest))
      oldest = message.accepted.accepted_at;
  }
  return oldest;
}

PublishCore::Turn::Turn(PublishCore& core) : core_(core) {
  while (core.turn_taken_) core.changed_.wait(core.mutex);
  core.turn_taken_ = true;
  ++core.turns_;
}

PublishCore::Turn::~Turn() {
  core_.turn_taken_ = false;
  if (std::exchange(core_.left_for_turn_, false) && core_.has_waiting()) core_.transport_.wake();
  core_.changed_.notify_all();
}

void PublishCore::send_waiting(const Turn& /*turn*/, std::size_t most) {
  for (std::size_t left = lanes_.size(); left > 0 && !lanes_.empty(); --left) {
    PublishLane& lane = *lanes_.front();
    send_lane(lane, most);
    lanes_.pop_front();
    lane.listed = !lane.runnable.empty();
    if (lane.listed) lanes_.push_back(&lane);
  }
}

void PublishCore::send_lane(PublishLane& lane, std::size_t most) {
  using Room = PublishTransport::Room;
  bool sent = false;
  while (most > 0 && !lane.runnable.empty() && (one_by_one_ == 0 || under_way_.empty())) {
    const std::shared_ptr<Outbox> outbox = lane.runnable.front();
    if (outbox->may_expire()) {
      outbox->expire(clock_.now());
      note(outbox);
    }
    Room room = Room::not_for_this_publisher;
    if (!outbox->idle() && outbox->may_send()) {
      room = transport_.room(outbox, outbox->next().message, false);
    }
    if (room == Room::full) break;
    lane.runnable.pop_front();
    outbox->in_runnable = false;
    if (room != Room::yes) continue;
    UnderWay& message = begin(outbox, outbox->take_next());
    make_runnable(outbox);  // the publishers of a lane take turns
    transport_.send(message);
    sent = true;
    --most;
  }
  if (sent) transport_.send_gathered();
}

bool PublishCore::has_waiting() const {
  return !lanes_.empty() && (one_by_one_ == 0 || under_way_.empty());
}

void PublishCore::open(const std::shared_ptr<Outbox>& outbox) {
  if (outbox->closed) return;
  outbox->ready = true;
  make_runnable(outbox);
}

void PublishCore::make_runnable(const std::shared_ptr<Outbox>& outbox) {
  if (outbox->in_runnable || outbox->idle() || !outbox->may_send()) return;
  outbox->in_runnable = true;
  PublishLane& lane = *outbox->lane;
  lane.runnable.push_back(outbox);
  if (!std::exchange(lane.listed, true)) lanes_.push_back(&lane);
}

UnderWay& PublishCore::begin(std::shared_ptr<Outbox> outbox, AcceptedMessage&& accepted) {
  if (spare_.empty()) {
    under_way_.emplace_back();
  } else {
    under_way_.splice(under_way_.end(), spare_, spare_.begin());
  }
  UnderWay& message = under_way_.back();
  message.outbox = std::move(outbox);
  message.accepted = std::move(accepted);
  message.returned = false;
  message.self = std::prev(under_way_.end());
  return message;
}

std::shared_ptr<Outbox> PublishCore::end(UnderWay& message, AcceptedMessage& accepted) {
  accepted = std::move(message.accepted);
  message.encoded = {};
  std::shared_ptr<Outbox> outbox = std::move(message.outbox);
  if (one_by_one_ > 0) --one_by_one_;
  if (spare_.size() < most_spare) {
    spare_.splice(spare_.begin(), under_way_, message.self);
  } else {
    under_way_.erase(message.self);
  }
  return outbox;
}

void PublishCore::changed(const std::shared_ptr<Outbox>& outbox) {
  note(outbox);
  make_runnable(outbox);
}

template <typename Tell>
void PublishCore::answered(UnderWay& message, Tell tell) {
  AcceptedMessage accepted;
  const std::shared_ptr<Outbox> outbox = end(message, accepted);
  if (outbox->closed) return;
  tell(*outbox, std::move(accepted));
  changed(outbox);
}

void PublishCore::confirmed(UnderWay& message) {
  answered(message, [](Outbox& outbox, const AcceptedMessage& accepted) { outbox.confirmed(accepted.number); });
}

void PublishCore::refused(UnderWay& message, const std::string& why) {
  answered(message, [&](Outbox& outbox, const AcceptedMessage& accepted) { outbox.refused(accepted.number, why); });
}

void PublishCore::refused_for_now(UnderWay& message, const std::string& why) {
  answered(message, [&, now = clock_.now()](Outbox& outbox, AcceptedMessage&& accepted) {
    if (outbox.refused_for_now(std::move(accepted), why, now)) {
      logger.error("the server refuses messages for topic {}: {}; they are kept and tried again until it takes them",
                   outbox.topic.name, why);
    }
  });
}

void PublishCore::returned(UnderWay& message) {
  answered(message, [now = clock_.now()](Outbox& outbox, AcceptedMessage&& accepted) {
    outbox.returned(std::move(accepted), now);
  });
}

void PublishCore::put_off(UnderWay& message) {
  answered(message, [now = clock_.now()](Outbox& outbox, AcceptedMessage&& accepted) {
    outbox.put_off(std::move(accepted), now);
  });
}

void PublishCore::lost(UnderWay& message) {
  answered(message, [](Outbox& outbox, AcceptedMessage&& accepted) { outbox.lost(std::move(accepted)); });
}

void PublishCore::failed(UnderWay& message) {
  answered(message, [](Outbox& outbox, AcceptedMessage&& accepted) {
    const bool ready = outbox.ready;
    outbox.disconnected();
    outbox.ready = ready;
    outbox.lost(std::move(accepted));
  });
}

void PublishCore::nobody_reads(const std::shared_ptr<Outbox>& outbox) {
  if (!outbox->idle() && outbox->may_send()) outbox->returned(outbox->take_next(), clock_.now());
  changed(outbox);
}

void PublishCore::connection_lost(bool one_by_one) {
  std::size_t again = 0;
  while (!under_way_.empty()) {
    AcceptedMessage accepted;
    const std::shared_ptr<Outbox> outbox = end(under_way_.front(), accepted);
    if (outbox->closed) continue;
    outbox->lost(std::move(accepted));
    note(outbox);
    ++again;
  }
  one_by_one_ = one_by_one ? again : 0;
  for (PublishLane* const lane : lanes_) {
    lane->runnable.clear();
    lane->listed = false;
  }
  lanes_.clear();
  for (const auto& outbox : outboxes_) {
    outbox->lane->runnable.clear();  // also lanes that are not in lanes_, because the loss interrupted their sending
    outbox->in_runnable = false;
    if (one_by_one) {
      outbox->interrupted();
    } else {
      outbox->disconnected();
    }
    note(outbox);
  }
}

UnderWay* PublishCore::the_only_one() {
  return under_way_.size() == 1 && !under_way_.front().outbox->closed ? &under_way_.front() : nullptr;
}

bool PublishCore::fire_timers() {
  bool fired = false;
  // fire() calls the lambda with the mutex held, which the analysis cannot see.
  timers_.fire(outboxes_, clock_.now(), [&](const std::shared_ptr<Outbox>& outbox) {
    mutex.assert_held();
    list_for_report(outbox);
    make_runnable(outbox);
    fired = true;
  });
  return fired;
}

void PublishCore::list_for_report(const std::shared_ptr<Outbox>& outbox) {
  if (outbox->in_report || !outbox->has_report()) return;
  outbox->in_report = true;
  to_report_.push_back(outbox);
}

void PublishCore::note(const std::shared_ptr<Outbox>& outbox) {
  list_for_report(outbox);
  if (timers_.note(*outbox)) transport_.wake();
}

void PublishCore::report() {
  while (!to_report_.empty()) {
    const std::shared_ptr<Outbox> outbox = to_report_.front();
    report(outbox);
  }
}

void PublishCore::report(const std::shared_ptr<Outbox>& outbox) {
  while (outbox->reporter != std::thread::id()) changed_.wait(mutex);
  if (std::exchange(outbox->in_report, false)) std::erase(to_report_, outbox);
  bool writable = false;
  std::vector<Outbox::Event> events = outbox->take_events(writable);
  if (events.empty() && !writable) return;
  outbox->reporter = std::this_thread::get_id();
  {
    const config::Unlocked unlocked(mutex);
    call_back(*outbox, events, writable);
  }
  outbox->reporter = {};
  outbox->reported(std::move(events));
  changed_.notify_all();
}

void PublishCore::call_back(Outbox& outbox, const std::vector<Outbox::Event>& events, bool writable) {
  for (const auto& event : events) meters_.outcome(event.outcome, event.reason);
  try {
    if (outbox.options.on_outcome) {
      for (const auto& event : events) outbox.options.on_outcome(event.number, event.outcome, event.reason);
    }
    if (writable && outbox.options.on_writable) outbox.options.on_writable();
  } catch (const std::exception& error) {
    logger.error("a callback of the publisher of topic {} threw: {}", outbox.topic.name, error.what());
  } catch (...) {
    logger.error("a callback of the publisher of topic {} threw", outbox.topic.name);
  }
}

}  // namespace iotcloud::brokers::client
