#include "iotcloud/brokers/activemq/publish_link.h"

#include <algorithm>
#include <utility>

#include <proton/delivery.hpp>
#include <proton/message.hpp>
#include <proton/receiver_options.hpp>
#include <proton/session.hpp>

#include "iotcloud/brokers/activemq/names.h"
#include "iotcloud/brokers/activemq/wire_message.h"
#include "iotcloud/brokers/limits.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::activemq {
namespace {

const config::Logger logger{"brokers.activemq"};

// So many bytes may wait for the socket; what is behind them stays with its publisher.
constexpr std::size_t buffered = 4U << 20U;
// A queue that an operator deletes under a publisher is missed after this time at the latest.
constexpr std::chrono::seconds route_lasts{10};
// A topic of the server's own: it says which queue has one reader more or less.
constexpr std::string_view readers_topic = "topic://ActiveMQ.Advisory.Consumer.Queue.";

}  // namespace

Outlet::Outlet(const Topic& to, const PublisherOptions& how)
    : Outbox(to, how), own_queue(activemq::own_queue(to.name)) {}

PublishLink::PublishLink(proton::container& container, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
                         std::string purpose, Meters& meters, ConnectionLog& log)
    : ServerLink(container, options, urls, std::move(purpose), log), meters_(meters) {}

std::shared_ptr<Outlet> PublishLink::add(const Topic& topic, const PublisherOptions& options) {
  auto outlet = std::make_shared<Outlet>(topic, options);
  {
    const Lock lock(mutex_);
    outlet->ready = connected();
    outlets_.push_back(outlet);
  }
  start();
  return outlet;
}

void PublishLink::remove(const std::shared_ptr<Outlet>& outlet) {
  Lock lock(mutex_);
  std::vector<std::uint64_t> numbers;
  for (const UnderWay& entry : under_way_) {
    if (entry.outlet == outlet && !entry.answered) numbers.push_back(entry.outgoing.number);
  }
  outlet->close(numbers);
  std::erase(outlets_, outlet);
  if (outlet->reporting && on_io_thread()) return;  // from inside its own callback
  reporter_.report(outlet, lock);
}

PublishStatus PublishLink::publish(const std::shared_ptr<Outlet>& outlet, Message message, const Past& past) {
  const char* why_not = refusal(message);
  Lock lock(mutex_);
  if (outlet->closed) return PublishStatus::closed;
  const Instant moment = now();
  if (why_not != nullptr) {
    const Outgoing refused = outlet->accept(std::move(message), moment);
    outlet->sent_directly();
    outlet->refused(refused.number, why_not);
    reporter_.note(outlet);
    wake();
    return PublishStatus::accepted;
  }
  outlet->expire(moment);
  if (!outlet->has_room()) {
    outlet->refuse_room();
    reporter_.note(outlet);
    if (outlet->has_report()) wake();
    return PublishStatus::would_block;
  }
  const bool timed = outlet->idle() && outlet->options.deadline.count() > 0;
  outlet->add_waiting(outlet->accept(std::move(message), moment, past));
  reporter_.note(outlet);
  make_runnable(outlet);
  if (timed || outlet->has_report() || outlet->in_runnable) wake();
  return PublishStatus::accepted;
}

bool PublishLink::drain(const std::shared_ptr<Outlet>& outlet, std::chrono::milliseconds limit) {
  Lock lock(mutex_);
  return reporter_.drain(outlet, limit, lock);
}

std::size_t PublishLink::pending(const Outlet& outlet) const {
  const Lock lock(mutex_);
  return outlet.pending();
}

ConnectionState PublishLink::state() const {
  const Lock lock(mutex_);
  if (closing_) return ConnectionState::closed;
  if (!connected()) return ConnectionState::connecting;
  return blocked_ ? ConnectionState::blocked : ConnectionState::connected;
}

void PublishLink::up() {
  // Only what happens from now on matters: who has no reader asks again in a while anyway.
  readers_ = connection().default_session().open_receiver(std::string(readers_topic) + ">",
                                                          proton::receiver_options().credit_window(1000));
  const Lock lock(mutex_);
  blocked_ = false;
  for (const auto& outlet : outlets_) {
    outlet->ready = true;
    make_runnable(outlet);
  }
}

void PublishLink::down() {
  readers_ = {};
  const Lock lock(mutex_);
  blocked_ = false;
  std::size_t again = 0;
  for (UnderWay& entry : under_way_) {
    if (entry.answered || entry.outlet->closed) continue;
    entry.outlet->lost(std::move(entry.outgoing));
    reporter_.note(entry.outlet);
    ++again;
  }
  under_way_.clear();
  if (blamed()) one_by_one_ = again;
  for (const auto& outlet : runnable_) outlet->in_runnable = false;
  runnable_.clear();
  for (const auto& outlet : outlets_) {
    outlet->disconnected();
    outlet->route = Outlet::Route::unknown;
  }
}

std::size_t PublishLink::under_way() const {
  const Lock lock(mutex_);
  return under_way_.size();
}

void PublishLink::blame(const std::string& why) {
  const Lock lock(mutex_);
  UnderWay& entry = under_way_.front();
  if (entry.answered || entry.outlet->closed) return;
  logger.error("the server closed the connection when it got a message for {}: {}", entry.outlet->topic.name, why);
  entry.answered = true;
  entry.outlet->refused(entry.outgoing.number, why);
  reporter_.note(entry.outlet);
  one_by_one_ = 0;
}

void PublishLink::serve() {
  fire_timers();
  Lock lock(mutex_);
  if (connected()) send_waiting(lock);
  reporter_.report_all(lock);
}

void PublishLink::fire_timers() {
  const Lock lock(mutex_);
  std::optional<Instant> next;
  for (const auto& outlet : outlets_) {
    std::optional<Instant> timer = outlet->next_timer();
    if (timer && *timer <= now()) {
      outlet->fire_timer(now());
      reporter_.note(outlet);
      make_runnable(outlet);
      timer = outlet->next_timer();
    }
    if (timer && (!next || *timer < *next)) next = timer;
  }
  if (next) arm(*next);
}

void PublishLink::make_runnable(const std::shared_ptr<Outlet>& outlet) {
  if (outlet->in_runnable || outlet->idle() || !outlet->may_send() || outlet->route == Outlet::Route::asked) return;
  outlet->in_runnable = true;
  runnable_.push_back(outlet);
}

void PublishLink::send_waiting(Lock& lock) {
  blocked_ = false;
  while (!runnable_.empty() && connected()) {
    if (one_by_one_ > 0 && !under_way_.empty()) return;
    if (sender().credit() <= 0) {
      blocked_ = under_way_.empty();
      return;
    }
    if (sender().session().outgoing_bytes() > buffered) return;  // an answer to what is under way comes back here
    const std::shared_ptr<Outlet> outlet = runnable_.front();
    runnable_.pop_front();
    outlet->in_runnable = false;
    outlet->expire(now());
    reporter_.note(outlet);
    if (outlet->idle() || !outlet->may_send()) continue;
    if (outlet->options.own_queue && outlet->route != Outlet::Route::known) {
      outlet->route = Outlet::Route::known;  // the server makes that queue
      outlet->own_queue_exists = true;
      outlet->address = send_address(outlet->topic.name, true);
    } else if (outlet->route == Outlet::Route::unknown || route_is_old(*outlet)) {
      outlet->route = Outlet::Route::asked;
      outlet->asked_at = now();
      lock.unlock();
      find_route(outlet);
      lock.lock();
      continue;
    }
    Outgoing next = outlet->take_next();
    make_runnable(outlet);  // in turn with the others
    send(lock, outlet, std::move(next));
  }
}

bool PublishLink::route_is_old(const Outlet& outlet) const {
  return !outlet.options.own_queue && now() - outlet.asked_at > route_lasts;
}

void PublishLink::send(Lock& lock, const std::shared_ptr<Outlet>& outlet, Outgoing outgoing) {
  Envelope envelope;
  envelope.to = outlet->address;
  envelope.durable = outlet->topic.durable;
  envelope.resent = outgoing.resent || outgoing.old;
  envelope.priority = outlet->options.priority;
  if (outlet->options.deadline.count() > 0) {
    const auto left = outgoing.accepted + outlet->options.deadline - now();
    envelope.expires_in = std::max(std::chrono::milliseconds(1), std::chrono::ceil<std::chrono::milliseconds>(left));
  }
  under_way_.push_back({{}, outlet, std::move(outgoing), false});
  // The entry stays where it is meanwhile: only this thread takes entries out.
  UnderWay& entry = under_way_.back();
  lock.unlock();
  entry.tracker = sender().send(to_wire(entry.outgoing.message, envelope));
  lock.lock();
}

void PublishLink::find_route(const std::shared_ptr<Outlet>& outlet) {
  ask(queues_pattern(outlet->topic.name),
      [this, outlet](const std::vector<QueueFacts>& queues) { on_route(outlet, queues); });
}

void PublishLink::on_route(const std::shared_ptr<Outlet>& outlet, const std::vector<QueueFacts>& queues) {
  const Lock lock(mutex_);
  if (outlet->closed) return;
  outlet->own_queue_exists = std::any_of(queues.begin(), queues.end(),
                                         [&](const QueueFacts& queue) { return queue.name == outlet->own_queue; });
  outlet->address = send_address(outlet->topic.name, outlet->own_queue_exists);
  outlet->asked_at = now();
  outlet->route = queues.empty() ? Outlet::Route::unknown : Outlet::Route::known;
  if (queues.empty() && !outlet->idle() && outlet->may_send()) {
    Outgoing next = outlet->take_next();
    if (next.resent) {  // somebody may have got it before: it stays marked
      outlet->put_off(std::move(next), now());
    } else {
      outlet->returned(std::move(next), now());
    }
  }
  reporter_.note(outlet);
  make_runnable(outlet);
  wake();
}

void PublishLink::on_other_message(proton::delivery&, proton::message& message) {
  const std::string about = message.to();
  if (!about.starts_with(readers_topic)) return;
  const std::string queue = about.substr(readers_topic.size());
  const Lock lock(mutex_);
  for (const auto& outlet : outlets_) {
    if (outlet->route == Outlet::Route::known && !outlet->own_queue_exists && outlet->own_queue == queue) {
      outlet->route = Outlet::Route::unknown;
    }
  }
}

void PublishLink::on_sendable(proton::sender& sender) {
  if (sender.connection() != connection()) return;
  const Lock lock(mutex_);
  if (!runnable_.empty()) wake();
}

void PublishLink::on_tracker_accept(proton::tracker& tracker) {
  guarded([&] { on_verdict(tracker, Verdict::accepted); });
}

void PublishLink::on_tracker_reject(proton::tracker& tracker) {
  guarded([&] { on_verdict(tracker, Verdict::rejected); });
}

void PublishLink::on_tracker_release(proton::tracker& tracker) {
  guarded([&] { on_verdict(tracker, Verdict::released); });
}

void PublishLink::on_verdict(const proton::tracker& tracker, Verdict verdict) {
  const Lock lock(mutex_);
  const auto found = std::find_if(under_way_.begin(), under_way_.end(),
                                  [&](const UnderWay& entry) { return entry.tracker == tracker; });
  if (found == under_way_.end() || found->answered) return;  // a question's, or of an earlier connection
  found->answered = true;
  if (one_by_one_ > 0) --one_by_one_;
  Outlet& outlet = *found->outlet;
  if (!outlet.closed) {
    if (verdict == Verdict::accepted) {
      outlet.confirmed(found->outgoing.number);
    } else if (verdict == Verdict::rejected) {
      outlet.refused(found->outgoing.number, "the server rejected it");
    } else {
      outlet.put_off(std::move(found->outgoing), now());
    }
    reporter_.note(found->outlet);
    make_runnable(found->outlet);
  }
  while (!under_way_.empty() && under_way_.front().answered) under_way_.pop_front();
  wake();
}

}  // namespace iotcloud::brokers::activemq
