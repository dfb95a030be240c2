#include "iotcloud/brokers/rabbitmq/consuming/consume_link.h"

#include <algorithm>
#include <exception>
#include <utility>

#include <pthread.h>

#include "iotcloud/brokers/rabbitmq/publishing/burst.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::rabbitmq {
namespace {

const config::Logger logger{"brokers.rabbitmq"};

// After so many handlers the socket is looked at again and settlements are sent.
constexpr std::size_t batch = 64;
// Acknowledgements may gather for so long: then one tells the server of many messages.
constexpr std::chrono::milliseconds gathering_time{2};
// So long what was handed on may be settled before the connection moves to the preferred server.
constexpr std::chrono::seconds moving_patience{2};
constexpr std::chrono::milliseconds moving_period{50};

}  // namespace

ConsumeLink::ConsumeLink(const Cluster& cluster, const char* purpose, Meters& meters, const config::Clock& clock,
                         ConnectionLog& log)
    : cluster_(cluster),
      purpose_(purpose),
      meters_(meters),
      clock_(clock),
      log_(log),
      channel_limit_(static_cast<std::size_t>(cluster.channels())),
      servers_(cluster.size()) {}

void ConsumeLink::close() {
  {
    const Lock lock(mutex_);
    if (std::exchange(closing_, true) || !started_) return;
  }
  sleep_.signal();
  thread_.join();
  // Inlets hold their link: what is left of them here must not hold it in a circle.
  const Lock lock(mutex_);
  ready_.clear();
  dirty_.clear();
  channels_.clear();
}

std::shared_ptr<Inlet> ConsumeLink::add(const Topic& topic, const SubscriptionOptions& options, Handler handler) {
  auto inlet = std::make_shared<Inlet>(shared_from_this(), topic, options, std::move(handler));
  const Lock lock(mutex_);
  inlets_.push_back(inlet);
  set_timer(*inlet, clock_.now());
  start();
  return inlet;
}

void ConsumeLink::start() {
  if (closing_) return;
  if (!std::exchange(started_, true)) {
    thread_ = std::thread([this] { run(); });
    pthread_setname_np(thread_.native_handle(), "amqp-consume");
  }
  wake();
}

bool ConsumeLink::has_room() const {
  const Lock lock(mutex_);
  return inlets_.size() < channel_limit_;
}

bool ConsumeLink::crowded() const {
  const Lock lock(mutex_);
  return inlets_.size() > channel_limit_;
}

void ConsumeLink::share(ConsumeLink& other) {
  const std::scoped_lock lock(mutex_, other.mutex_);
  for (auto i = inlets_.size(); i-- > 0 && inlets_.size() > channel_limit_;) {
    if (other.inlets_.size() >= other.channel_limit_) break;
    const std::shared_ptr<Inlet> inlet = inlets_[i];
    if (inlet->phase != Inlet::Phase::idle || inlet->running) continue;
    inlets_.erase(inlets_.begin() + static_cast<std::ptrdiff_t>(i));
    std::erase(ready_, inlet);
    std::erase(dirty_, inlet);
    inlet->in_ready = inlet->in_dirty = false;
    other.set_timer(*inlet, clock_.now());
    inlet->move_to(other.shared_from_this());
    other.inlets_.push_back(inlet);
  }
  other.start();
}

bool ConsumeLink::must_ask_preferred() const {
  const Lock lock(mutex_);
  return servers_.must_ask(clock_.now());
}

void ConsumeLink::preferred_answered(bool answers) {
  const Lock lock(mutex_);
  servers_.asked(answers, clock_.now());
  if (servers_.must_move_back(clock_.now())) wake();
}

bool ConsumeLink::remove(const std::shared_ptr<Inlet>& inlet) {
  Lock lock(mutex_);
  if (!at_home(*inlet)) return false;
  inlet->closed = true;
  std::erase(inlets_, inlet);
  if (wire_ && inlet->channel != 0) {
    try {
      send_settlements(*inlet, 0);
      close_channel(*inlet);
    } catch (const std::exception&) {
      broken_ = true;
      wake();
    }
  }
  if (inlet->phase != Inlet::Phase::idle) inlet->forget_channel();
  if (std::this_thread::get_id() != thread_.get_id()) {
    handler_ended_.wait(lock, [&] { return !inlet->running; });
  }
  return true;
}

bool ConsumeLink::pause(Inlet& inlet) {
  const Lock lock(mutex_);
  if (!at_home(inlet)) return false;
  inlet.paused = true;
  return true;
}

bool ConsumeLink::resume(const std::shared_ptr<Inlet>& inlet) {
  const Lock lock(mutex_);
  if (!at_home(*inlet)) return false;
  inlet->paused = false;
  make_ready(inlet);
  wake();
  return true;
}

bool ConsumeLink::active(const Inlet& inlet) const {
  const Lock lock(mutex_);
  return at_home(inlet) && inlet.phase == Inlet::Phase::active;
}

ConnectionState ConsumeLink::state() const {
  const Lock lock(mutex_);
  if (closing_) return ConnectionState::closed;
  return !started_ || wire_ ? ConnectionState::connected : ConnectionState::connecting;
}

void ConsumeLink::wake() {
  if (!sleeping_) return;
  sleeping_ = false;
  sleep_.signal();
}

void ConsumeLink::make_ready(const std::shared_ptr<Inlet>& inlet) {
  if (inlet->in_ready || !inlet->has_work()) return;
  inlet->in_ready = true;
  ready_.push_back(inlet);
}

void ConsumeLink::settle(const std::shared_ptr<Inlet>& inlet, std::uint64_t public_tag,
                         Settlement settlement) noexcept {
  const Lock lock(mutex_);
  constexpr std::uint64_t tag_mask = (std::uint64_t{1} << 48U) - 1;
  const std::uint64_t tag = public_tag & tag_mask;
  if (!at_home(*inlet)) return;  // it moved, so this is late
  if (inlet->closed || public_tag != inlet->public_tag(tag) || !inlet->window.settle(tag, settlement)) return;
  if (settlement == Settlement::retry) {
    make_ready(inlet);
    wake();
    return;
  }
  if (!inlet->in_dirty) {
    inlet->in_dirty = true;
    dirty_.push_back(inlet);
  }
  // The link's thread sends them when its handlers are done. When it sleeps, or is busy and a good part of the
  // prefetch waits for it, this thread does.
  const bool waits_for_others =
      std::this_thread::get_id() == thread_.get_id() || (!sleeping_ && inlet->window.settled() <= inlet->patience());
  if (!wire_ || broken_) return;
  try {
    if (waits_for_others) return;
    if (settlements_due()) {
      send_all_settlements();
    } else {
      sleep_.signal_after(settled_at_ + gathering_time - clock_.now());
    }
  } catch (const std::exception&) {
    broken_ = true;
    wake();
  }
}

void ConsumeLink::run() {
  bool look = true;
  Lock lock(mutex_);
  while (!closing_) {
    try {
      if (!wire_) connect(lock);
      if (wire_) {
        if (broken_) throw LinkError("it broke");
        check_timers();
        if (look || wire_->has_buffered()) read_frames();
        hand_on(lock, batch);
        if (wire_ && !broken_ && settlements_due()) send_all_settlements();
        if (wire_ && !broken_) move_back(lock);
      }
    } catch (const std::exception& error) {  // LinkError, or memory that ran out: both end this connection
      lose(error.what());
    }
    if (closing_) break;
    look = true;
    if (wire_ && !broken_ && wire_->has_buffered()) continue;  // there is no need to ask the socket
    const bool more = (!ready_.empty() && !moving_since_) || broken_;
    const std::chrono::milliseconds limit = more ? std::chrono::milliseconds(0) : time_to_sleep();
    sleep_.watch(wire_ ? wire_->descriptor() : -1, false);
    sleeping_ = !more;
    lock.unlock();
    const LinkSleep::Result woken = sleep_.wait(limit);
    lock.lock();
    sleeping_ = false;
    look = woken.readable || !more;  // after a time-out too: heartbeats
  }
  try {
    if (wire_) send_all_settlements();
  } catch (const std::exception& error) {  // it broke: what was settled last is delivered again
    log_.lost(error.what());
  }
  std::unique_ptr<AmqpLink> wire = std::move(wire_);
  lock.unlock();
  if (wire) wire->close(0);
}

void ConsumeLink::connect(Lock& lock) {
  const std::optional<std::size_t> server = servers_.due(clock_.now());
  if (!server) return;
  lock.unlock();
  std::unique_ptr<AmqpLink> wire;
  try {
    wire = cluster_.connect(*server, purpose_);
    log_.connected(cluster_.name(*server));
  } catch (const LinkError& error) {
    log_.failed(cluster_.name(*server), error.what());
  }
  lock.lock();
  broken_ = false;
  wire_ = std::move(wire);
  if (!wire_) {
    servers_.failed(*server, clock_.now());
    return;
  }
  servers_.connected(*server, clock_.now());
  channel_limit_ = static_cast<std::size_t>(wire_->channel_limit());
  for (const auto& inlet : inlets_) set_timer(*inlet, clock_.now());
}

void ConsumeLink::lose(const std::string& reason) {
  if (servers_.current()) log_.lost(cluster_.name(*servers_.current()), reason);
  servers_.lost(clock_.now());
  wire_.reset();
  forget_connection();
}

void ConsumeLink::forget_connection() {
  broken_ = false;
  moving_since_.reset();
  channels_.clear();
  for (const auto& inlet : ready_) inlet->in_ready = false;
  ready_.clear();
  for (const auto& inlet : dirty_) inlet->in_dirty = false;
  dirty_.clear();
  for (const auto& inlet : inlets_) {
    inlet->forget_channel();
    inlet->backoff.reset();
  }
}

void ConsumeLink::move_back(Lock& lock) {
  const config::Clock::Instant now = clock_.now();
  if (!moving_since_) {
    if (!servers_.must_move_back(now)) return;
    moving_since_ = now;
  }
  const bool idle =
      std::all_of(inlets_.begin(), inlets_.end(), [](const auto& inlet) { return inlet->window.handed_on() == 0; });
  if (!idle && now - *moving_since_ < moving_patience) return;
  for (const auto& inlet : inlets_) {
    if (inlet->channel != 0) send_settlements(*inlet, 0);
  }
  const std::unique_ptr<AmqpLink> wire = std::move(wire_);
  servers_.left();
  forget_connection();
  lock.unlock();
  wire->close(0);
  lock.lock();
}

void ConsumeLink::hand_on(Lock& lock, std::size_t most) {
  Burst burst(clock_);
  for (std::size_t i = 0; i < most && !ready_.empty() && !closing_ && !moving_since_; ++i) {
    const std::shared_ptr<Inlet> inlet = std::move(ready_.front());
    ready_.pop_front();
    inlet->in_ready = false;
    if (!inlet->has_work()) continue;
    const auto done_with = [&](const Arrived& arrived) {
      inlet->window.settle(arrived.tag, Settlement::accept);
      if (!std::exchange(inlet->in_dirty, true)) dirty_.push_back(inlet);
    };
    while (inlet->options.keep_last > 0 && inlet->window.waiting() > inlet->options.keep_last) {
      done_with(inlet->window.next());
      meters_.conflated();
    }
    Arrived arrived = inlet->window.next();
    make_ready(inlet);  // in turn with the others
    meters_.received(arrived.redelivered);
    std::shared_ptr<Settler> settler = inlet;
    if (inlet->options.automatic_ack) {
      settler = nullptr;
      done_with(arrived);
    }
    const std::uint64_t tag = inlet->public_tag(arrived.tag);
    inlet->running = handling_ = true;
    burst.before_handler(!ready_.empty() && i + 1 < most, inlet->quick);
    lock.unlock();
    run_handler(*inlet, std::move(arrived), std::move(settler), tag);
    inlet->quick = burst.after_handler().value_or(inlet->quick);
    lock.lock();
    inlet->running = handling_ = false;
    if (inlet->closed) handler_ended_.notify_all();
  }
}

void ConsumeLink::run_handler(const Inlet& inlet, Arrived arrived, std::shared_ptr<Settler> settler,
                              std::uint64_t tag) {
  try {
    Delivery delivery(std::move(arrived.message), arrived.redelivered, std::move(settler), tag);
    delivery.tries = arrived.tries;
    inlet.handler(std::move(delivery));
  } catch (const std::exception& error) {
    logger.error("the handler of topic {} threw: {}; the message is delivered again", inlet.topic.name, error.what());
  } catch (...) {
    logger.error("the handler of topic {} threw; the message is delivered again", inlet.topic.name);
  }
}

bool ConsumeLink::settlements_due() const {
  if (dirty_.empty()) return false;
  if (clock_.now() - settled_at_ >= gathering_time) return true;
  return std::any_of(dirty_.begin(), dirty_.end(),
                     [](const auto& inlet) { return inlet->window.settled() > inlet->patience(); });
}

void ConsumeLink::attend() {
  const Lock lock(mutex_);
  if (!handling_ || !wire_ || broken_) return;
  try {
    check_timers();
    read_frames();
    send_all_settlements();
  } catch (const std::exception&) {
    broken_ = true;
  }
}

std::chrono::milliseconds ConsumeLink::time_to_sleep() const {
  const config::Clock::Instant now = clock_.now();
  const auto until = [&](config::Clock::Instant instant) {
    return std::max(std::chrono::milliseconds(0), std::chrono::ceil<std::chrono::milliseconds>(instant - now));
  };
  if (!wire_) return until(servers_.next_attempt());
  std::chrono::milliseconds limit = std::chrono::milliseconds(wire_->heartbeat()) / 2;
  if (moving_since_) limit = std::min(limit, moving_period);
  if (next_timer_) limit = std::min(limit, until(*next_timer_));
  if (!dirty_.empty()) limit = std::min(limit, until(settled_at_ + gathering_time));
  return limit;
}

}  // namespace iotcloud::brokers::rabbitmq
