#include "iotcloud/brokers/rabbitmq/publishing/publish_link.h"

#include <algorithm>
#include <cstddef>
#include <exception>
#include <utility>

#include <linux/tcp.h>
#include <netinet/in.h>
#include <pthread.h>
#include <sys/socket.h>

#include "iotcloud/brokers/limits.h"
#include "iotcloud/brokers/rabbitmq/wire/declarations.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

// A caller sends at most so many of others' messages beside its own.
constexpr std::size_t helping = 16;
// After so many refusals in a row to store one publisher's messages the connection is made anew.
constexpr std::size_t nacks_of_stale_channel = 4;
constexpr std::chrono::minutes long_ago{1};

}  // namespace

PublishLink::PublishLink(const Cluster& cluster, const char* purpose, Meters& meters, const config::Clock& clock,
                         ConnectionLog& log)
    : cluster_(cluster), purpose_(purpose), meters_(meters), clock_(clock), log_(log), servers_(cluster.size()) {
  thread_ = std::thread([this] { run(); });
  pthread_setname_np(thread_.native_handle(), "amqp-publish");
}

PublishLink::~PublishLink() {
  reachable_->gone();
  {
    Lock lock(mutex_);
    closing_ = true;
    changed_.notify_all();
  }
  sleep_.signal();
  thread_.join();
}

std::shared_ptr<Outbox> PublishLink::add(const Topic& topic, const PublisherOptions& options) {
  auto outbox = std::make_shared<Outbox>(topic, options);
  Lock lock(mutex_);
  outboxes_.push_back(outbox);
  if (connected_) {
    undeclared_.push_back(outbox);
    wake(lock);
  }
  return outbox;
}

void PublishLink::remove(const std::shared_ptr<Outbox>& outbox) {
  Lock lock(mutex_);
  std::vector<std::uint64_t> numbers;
  for (const UnderWay& entry : under_way_) {
    if (entry.outbox == outbox && !entry.answered) numbers.push_back(entry.outgoing.number);
  }
  outbox->close(numbers);
  std::erase(outboxes_, outbox);
  std::erase(undeclared_, outbox);
  if (outbox->reporting && std::this_thread::get_id() == thread_.get_id()) return;  // from inside its own callback
  reporter_.report(outbox, lock);
}

PublishStatus PublishLink::publish(const std::shared_ptr<Outbox>& outbox, Message message, const Past& past) {
  const char* why_not = refusal(message);
  Lock lock(mutex_);
  if (outbox->closed) return PublishStatus::closed;
  const Instant now = clock_.now();
  if (why_not != nullptr) {
    const Outgoing refused = outbox->accept(std::move(message), now);
    outbox->sent_directly();
    outbox->refused(refused.number, why_not);
    note(outbox);
    wake(lock);
    return PublishStatus::accepted;
  }
  outbox->expire(now);
  note(outbox);
  if (outbox->has_report()) wake(lock);
  if (!outbox->has_room()) {
    outbox->refuse_room();
    want_answers(lock);
    return PublishStatus::would_block;
  }
  Outgoing outgoing = outbox->accept(std::move(message), now, past);
  const bool direct = connected_ && !blocked_ && !moving_since_ && !wire_busy_ && !wire_broken_ && one_by_one_ == 0 &&
                      runnable_.empty() && outbox->idle() && outbox->may_send() &&
                      wire_->room_for(outgoing.message.payload.size());
  if (!direct) {
    outbox->add_waiting(std::move(outgoing));
    const bool timed = note(outbox);
    make_runnable(outbox);
    if (!outbox->in_runnable) want_answers(lock);
    // Whoever has the wire looks again before giving it back.
    if (timed || outbox->has_report() || (outbox->in_runnable && !wire_busy_)) wake(lock);
    return PublishStatus::accepted;
  }
  acquire_wire(lock);
  const bool gathering = under_way_.size() < most_gathered;
  let_answers_gather();
  outbox->sent_directly();
  try {
    Burst* const burst = Burst::going_on();
    const bool first = !held_back_;
    send(lock, outbox, std::move(outgoing), burst != nullptr ? Leaving::in_a_burst : Leaving::at_once);
    send_waiting(lock, helping, false);
    if (held_back_ && first) burst->remember(reachable_);
    if (wire_->has_buffered()) wake(lock);
  } catch (const std::exception&) {  // LinkError, or memory that ran out in the middle of a frame
    if (!lock.owns_lock()) lock.lock();
    wire_broken_ = true;
  }
  release_wire();
  // Once there are so many answers to come the thread waits for them at the socket: it is woken to go there.
  const bool gathered = gathering && under_way_.size() >= most_gathered;
  if (wire_broken_ || !runnable_.empty() || reporter_.due() || gathered) wake(lock);
  return PublishStatus::accepted;
}

bool PublishLink::drain(const std::shared_ptr<Outbox>& outbox, std::chrono::milliseconds limit) {
  Lock lock(mutex_);
  want_answers(lock);
  return reporter_.drain(outbox, limit, lock);
}

std::size_t PublishLink::pending(const Outbox& outbox) const {
  const Lock lock(mutex_);
  return outbox.pending();
}

ConnectionState PublishLink::state() const {
  const Lock lock(mutex_);
  if (closing_) return ConnectionState::closed;
  if (!connected_) return ConnectionState::connecting;
  return blocked_ ? ConnectionState::blocked : ConnectionState::connected;
}

void PublishLink::watch() {
  const Lock lock(mutex_);
  if (!wire_busy_ || !wire_) return;
  const auto now = std::chrono::steady_clock::now();
  if (std::exchange(wire_taken_watched_, wire_taken_) != wire_taken_) busy_since_ = now;
  if (now - busy_since_ < cluster_.rpc_timeout()) return;
  tcp_info info{};
  socklen_t length = sizeof(info);
  if (::getsockopt(wire_->descriptor(), IPPROTO_TCP, TCP_INFO, &info, &length) == 0 &&
      length > offsetof(tcp_info, tcpi_bytes_acked) && info.tcpi_bytes_acked != acknowledged_bytes_) {
    acknowledged_bytes_ = info.tcpi_bytes_acked;  // slow, but it moves
    busy_since_ = now;
    return;
  }
  ::shutdown(wire_->descriptor(), SHUT_RDWR);  // the send that stands still fails now
}

bool PublishLink::must_ask_preferred() const {
  const Lock lock(mutex_);
  return servers_.must_ask(clock_.now());
}

void PublishLink::preferred_answered(bool answers) {
  Lock lock(mutex_);
  servers_.asked(answers, clock_.now());
  if (servers_.must_move_back(clock_.now())) wake(lock);
}

void PublishLink::wake(Lock& lock) {
  if (!sleeping_ || !lock.owns_lock()) return;
  sleeping_ = false;
  sleep_.signal();
}

void PublishLink::push() {
  const Lock lock(mutex_);
  push_held_back();
}

void PublishLink::push_held_back() {
  if (std::exchange(held_back_, false) && wire_) wire_->push();
}

void PublishLink::want_answers(Lock& lock) {
  push_held_back();
  if (under_way_.empty() || std::exchange(answers_wanted_, true)) return;
  wake(lock);
}

void PublishLink::let_answers_gather() {
  if (sleeping_ && under_way_.empty()) sleep_.put_off(gathering_time);
}

void PublishLink::acquire_wire(Lock& lock) {
  changed_.wait(lock, [this] { return !wire_busy_; });
  wire_busy_ = true;
  ++wire_taken_;
}

void PublishLink::release_wire() {
  wire_busy_ = false;
  changed_.notify_all();
}

void PublishLink::make_runnable(const std::shared_ptr<Outbox>& outbox) {
  if (outbox->in_runnable || outbox->idle() || !outbox->may_send()) return;
  outbox->in_runnable = true;
  runnable_.push_back(outbox);
}

void PublishLink::send(Lock& lock, const std::shared_ptr<Outbox>& outbox, Outgoing outgoing, Leaving leaving) {
  MessageProperties::Delivery delivery;
  delivery.durable = outbox->topic.durable;
  delivery.resent = outgoing.resent || outgoing.old;
  delivery.priority = outbox->options.priority;
  delivery.origin = {outbox->id, outgoing.number};
  if (outbox->options.deadline.count() > 0) {
    const auto left = outgoing.accepted + outbox->options.deadline - clock_.now();
    delivery.expires_in = std::max(std::chrono::milliseconds(1), std::chrono::ceil<std::chrono::milliseconds>(left));
  }
  under_way_.push_back({outbox, std::move(outgoing), false, false});
  // The entry stays where it is while the wire is ours: only the wire's owner takes entries out.
  const Message& message = under_way_.back().outgoing.message;
  lock.unlock();
  wire_->publish(publish_channel, exchange_of(outbox->topic), outbox->topic.name, properties_.encode(message, delivery),
                 message.payload.bytes());
  const bool held_back = leaving != Leaving::with_others && wire_->flush(leaving == Leaving::in_a_burst);
  lock.lock();
  held_back_ = held_back;
}

void PublishLink::send_waiting(Lock& lock, std::size_t most, bool first_may_wait) {
  if (runnable_.empty()) return;
  gather_waiting(lock, most, first_may_wait);
  lock.unlock();
  wire_->flush(false);
  lock.lock();
  held_back_ = false;
}

void PublishLink::gather_waiting(Lock& lock, std::size_t most, bool first_may_wait) {
  for (std::size_t sent = 0; sent < most && !runnable_.empty() && !blocked_ && !moving_since_; ++sent) {
    if (one_by_one_ > 0 && !under_way_.empty()) return;
    const std::shared_ptr<Outbox> outbox = runnable_.front();
    outbox->expire(clock_.now());
    note(outbox);
    if (outbox->idle() || !outbox->may_send()) {
      runnable_.pop_front();
      outbox->in_runnable = false;
      continue;
    }
    if (!std::exchange(first_may_wait, false) && !wire_->room_for(outbox->next().message.payload.size())) return;
    runnable_.pop_front();
    outbox->in_runnable = false;
    Outgoing next = outbox->take_next();
    make_runnable(outbox);  // in turn with the others
    send(lock, outbox, std::move(next), Leaving::with_others);
  }
}

void PublishLink::requeue_under_way() {
  std::deque<UnderWay> entries = std::exchange(under_way_, {});
  for (UnderWay& entry : entries) {
    if (entry.answered || entry.outbox->closed) continue;
    entry.outbox->lost(std::move(entry.outgoing));
    note(entry.outbox);
  }
}

void PublishLink::settle(UnderWay& entry, bool good, Instant now) {
  entry.answered = true;
  if (entry.outbox->closed) return;
  if (!good) {
    entry.outbox->put_off(std::move(entry.outgoing), now);
    // A channel that published while a quorum queue had no leader may never learn of the new one.
    if (entry.outbox->put_off_in_row() >= nacks_of_stale_channel && now >= next_renewal_) {
      if (now > next_renewal_ + long_ago) renewals_.reset();
      next_renewal_ = now + renewals_.next();
      stale_ = true;
    }
  } else if (entry.returned) {
    entry.outbox->returned(std::move(entry.outgoing), now);
    if (entry.outbox->options.own_queue && std::exchange(entry.outbox->ready, false)) {
      undeclared_.push_back(entry.outbox);  // its queue was deleted
    }
  } else {
    entry.outbox->confirmed(entry.outgoing.number);
  }
  note(entry.outbox);
  make_runnable(entry.outbox);
}

void PublishLink::on_answer(std::uint64_t tag, bool multiple, bool good) {
  const Lock lock(mutex_);
  const Instant now = clock_.now();
  if (tag < first_tag_ || tag >= first_tag_ + under_way_.size()) {
    if (tag != 0 || !multiple) return;  // tag 0 with multiple: all so far
    tag = first_tag_ + under_way_.size() - 1;
  }
  for (std::uint64_t i = multiple ? first_tag_ : tag; i <= tag && !under_way_.empty(); ++i) {
    UnderWay& entry = under_way_[i - first_tag_];
    if (!entry.answered) settle(entry, good, now);
    if (one_by_one_ > 0) --one_by_one_;
  }
  while (!under_way_.empty() && under_way_.front().answered) {
    under_way_.pop_front();
    ++first_tag_;
  }
  if (std::exchange(stale_, false)) throw LinkError("it stores no messages in a queue (nack) on this connection");
}

std::chrono::milliseconds PublishLink::time_to_sleep(Instant now) {
  std::chrono::milliseconds limit{1000};
  if (connected_) limit = std::min(limit, std::chrono::milliseconds(wire_->heartbeat()) / 2);
  timers_.fire(outboxes_, now, [&](const std::shared_ptr<Outbox>& outbox) {
    reporter_.note(outbox);
    if (connected_) make_runnable(outbox);
    limit = std::chrono::milliseconds(0);
  });
  if (timers_.next() == Instant::max()) return limit;
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(timers_.next() - now);
  return std::clamp(left, std::chrono::milliseconds(0), limit);
}

bool PublishLink::note(const std::shared_ptr<Outbox>& outbox) {
  reporter_.note(outbox);
  return timers_.note(*outbox);
}

}  // namespace iotcloud::brokers::rabbitmq
