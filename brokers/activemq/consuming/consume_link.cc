#include "iotcloud/brokers/activemq/consuming/consume_link.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <utility>

#include "iotcloud/brokers/activemq/names.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::activemq {
namespace {

const config::Logger logger{"brokers.activemq"};

// So many handlers run before the sockets are looked at again, or as many as fit into that time.
constexpr int handlers_in_a_row = 32;
constexpr std::chrono::microseconds time_in_a_row{1000};
// What handlers send that take longer is not kept back to be sent together.
constexpr std::chrono::microseconds quick{50};

}  // namespace

Inlet::Inlet(std::shared_ptr<ConsumeLink> link, std::string link_name, Topic to, SubscriptionOptions how, Handler what)
    : name(std::move(link_name)),
      topic(std::move(to)),
      options(std::move(how)),
      handler(std::move(what)),
      queue(queue_of(topic.name, options.group)),
      link_(std::move(link)) {}

void Inlet::settle(std::uint64_t tag, Settlement settlement) noexcept {
  link_->settle(shared_from_this(), tag, settlement);
}

ConsumeLink::ConsumeLink(IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
                         std::string purpose, Meters& meters, ConnectionLog& log)
    : ServerLink(loop, options, urls, std::move(purpose), log), meters_(meters) {}

void ConsumeLink::end() {
  {
    Lock lock(mutex_);
    ending_ = true;
    handler_ended_.wait(lock, [this] { return handler_thread_ == std::thread::id(); });
  }
  close();
  // Inlets hold their link: what is left of them here must not hold it in a circle.
  const Lock lock(mutex_);
  ready_.clear();
  dirty_.clear();
  leaving_.clear();
}

std::shared_ptr<Inlet> ConsumeLink::add(const Topic& topic, const SubscriptionOptions& options, Handler handler) {
  Lock lock(mutex_);
  auto inlet = std::make_shared<Inlet>(shared_from_this(), "r" + std::to_string(++last_name_), topic, options,
                                       std::move(handler));
  inlets_.push_back(inlet);
  try_at(*inlet, now());
  lock.unlock();
  start();
  return inlet;
}

void ConsumeLink::remove(const std::shared_ptr<Inlet>& inlet) {
  Lock lock(mutex_);
  inlet->closed = true;
  std::erase(inlets_, inlet);
  leaving_.push_back(inlet);
  wake();
  if (handler_thread_ == std::this_thread::get_id()) return;
  handler_ended_.wait(lock, [&] { return !inlet->running; });
}

void ConsumeLink::pause(Inlet& inlet) {
  const Lock lock(mutex_);
  inlet.paused = true;
}

void ConsumeLink::resume(const std::shared_ptr<Inlet>& inlet) {
  const Lock lock(mutex_);
  inlet->paused = false;
  make_ready(inlet);
  wake();
}

bool ConsumeLink::active(const Inlet& inlet) const {
  const Lock lock(mutex_);
  return inlet.phase == Inlet::Phase::active;
}

ConnectionState ConsumeLink::state() const {
  const Lock lock(mutex_);
  if (closing_) return ConnectionState::closed;
  return !started_ || connected() ? ConnectionState::connected : ConnectionState::connecting;
}

void ConsumeLink::make_ready(const std::shared_ptr<Inlet>& inlet) {
  if (inlet->in_ready || !inlet->has_work()) return;
  inlet->in_ready = true;
  ready_.push_back(inlet);
}

void ConsumeLink::make_dirty(const std::shared_ptr<Inlet>& inlet) {
  if (!std::exchange(inlet->in_dirty, true)) dirty_.push_back(inlet);
  // Who runs handlers and serves sends the settlements after them.
  if (!(loop_.serves() && handler_thread_ == std::this_thread::get_id())) wake();
}

void ConsumeLink::settle(const std::shared_ptr<Inlet>& inlet, std::uint64_t public_tag,
                         Settlement settlement) noexcept {
  const Lock lock(mutex_);
  constexpr std::uint64_t tag_mask = (std::uint64_t{1} << 48U) - 1;
  const std::uint64_t tag = public_tag & tag_mask;
  if (inlet->closed || public_tag != inlet->public_tag(tag) || !inlet->window.settle(tag, settlement)) return;
  if (settlement == Settlement::retry) {
    make_ready(inlet);
    wake();
  } else {
    make_dirty(inlet);
  }
}

bool ConsumeLink::has_handlers_to_run() {
  const Lock lock(mutex_);
  return !ready_.empty() && !ending_ && handler_thread_ == std::thread::id();
}

void ConsumeLink::run_handlers() {
  using Steady = std::chrono::steady_clock;
  Lock lock(mutex_);
  if (handler_thread_ != std::thread::id()) return;
  handler_thread_ = std::this_thread::get_id();
  const Steady::time_point begin = Steady::now();
  Steady::time_point last = begin;
  bool was_quick = true;
  for (int count = 0; !ready_.empty() && !ending_; ++count) {
    const bool serves = loop_.serves();
    if (serves && (count >= handlers_in_a_row || last - begin > time_in_a_row)) break;
    const std::shared_ptr<Inlet> inlet = std::move(ready_.front());
    ready_.pop_front();
    inlet->in_ready = false;
    if (!inlet->has_work()) continue;
    const bool more = !ready_.empty() || inlet->window.waiting() > 1;
    loop_.gather(serves && was_quick && more);
    hand_on(lock, inlet);
    const Steady::time_point now = Steady::now();
    was_quick = now - std::exchange(last, now) < quick;
    if (was_quick || !loop_.serves()) continue;
    lock.unlock();
    loop_.flush();
    lock.lock();
  }
  loop_.gather(false);
  handler_thread_ = {};
  handler_ended_.notify_all();
  if (!ready_.empty()) wake();
}

void ConsumeLink::hand_on(Lock& lock, const std::shared_ptr<Inlet>& inlet) {
  const auto done_with = [&](const client::Arrived& arrived) {
    inlet->window.settle(arrived.tag, Settlement::accept);
    make_dirty(inlet);
  };
  while (inlet->options.keep_last > 0 && inlet->window.waiting() > inlet->options.keep_last) {
    done_with(inlet->window.next());
    meters_.conflated();
  }
  client::Arrived arrived = inlet->window.next();
  make_ready(inlet);  // in turn with the others
  meters_.received(arrived.redelivered);
  std::shared_ptr<Settler> settler = inlet;
  if (inlet->options.automatic_ack) {
    settler = nullptr;
    done_with(arrived);
  }
  const std::uint64_t tag = inlet->public_tag(arrived.tag);
  inlet->running = true;
  lock.unlock();
  run_handler(*inlet, std::move(arrived), std::move(settler), tag);
  lock.lock();
  inlet->running = false;
  if (inlet->closed) handler_ended_.notify_all();
}

void ConsumeLink::run_handler(const Inlet& inlet, client::Arrived arrived, std::shared_ptr<Settler> settler,
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

}  // namespace iotcloud::brokers::activemq
