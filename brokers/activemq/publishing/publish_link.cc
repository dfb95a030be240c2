#include "iotcloud/brokers/activemq/publishing/publish_link.h"

#include <algorithm>
#include <utility>

#include <proton/connection.h>
#include <proton/delivery.h>
#include <proton/disposition.h>
#include <proton/link.h>
#include <proton/session.h>
#include <proton/terminus.h>

#include "iotcloud/brokers/activemq/names.h"
#include "iotcloud/brokers/activemq/wire/sections.h"
#include "iotcloud/brokers/activemq/wire/wire_message.h"
#include "iotcloud/brokers/limits.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::activemq {
namespace {

const config::Logger logger{"brokers.activemq"};

// So many bytes may wait for the socket; what is behind them stays with its publisher.
constexpr std::size_t buffered = 4U << 20U;
// A queue that an operator deletes under a publisher is missed after this time at the latest.
constexpr std::chrono::seconds route_lasts{10};
// So many of the server's news of readers may be under way.
constexpr int readers_at_once = 1000;
// A topic of the server's own: it says which queue has one reader more or less.
constexpr std::string_view readers_topic = "topic://ActiveMQ.Advisory.Consumer.Queue.";

}  // namespace

Outlet::Outlet(const Topic& to, const PublisherOptions& how)
    : Outbox(to, how), own_queue(activemq::own_queue(to.name)) {}

PublishLink::PublishLink(IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
                         std::string purpose, Meters& meters, ConnectionLog& log)
    : ServerLink(loop, options, urls, std::move(purpose), log), meters_(meters) {}

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
  if (outlet->reporting && reporting_ == std::this_thread::get_id()) return;  // from inside its own callback
  reporter_.report(outlet, lock);
}

PublishStatus PublishLink::publish(const std::shared_ptr<Outlet>& outlet, Message message, const Past& past) {
  const char* why_not = refusal(message);
  const Lock lock(mutex_);
  if (outlet->closed) return PublishStatus::closed;
  const Instant moment = now();
  if (why_not != nullptr) {
    const Outgoing refused = outlet->accept(std::move(message), moment);
    outlet->sent_directly();
    outlet->refused(refused.number, why_not);
    note(outlet);
    wake();
    return PublishStatus::accepted;
  }
  outlet->expire(moment);
  if (!outlet->has_room()) {
    outlet->refuse_room();
    note(outlet);
    if (outlet->has_report()) wake();
    return PublishStatus::would_block;
  }
  outlet->add_waiting(outlet->accept(std::move(message), moment, past));
  note(outlet);
  make_runnable(outlet);
  if (connected() && outlet->in_runnable) guarded([this] { send_now(); });
  if (outlet->has_report()) wake();
  return PublishStatus::accepted;
}

void PublishLink::send_now() {
  send_waiting();
  if (loop_.gathers()) return;
  engine().send();
  if (engine().wants_to_write()) wake();
}

bool PublishLink::drain(const std::shared_ptr<Outlet>& outlet, std::chrono::milliseconds limit) {
  flush();
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
  readers_ = pn_receiver(session(), "readers");
  pn_terminus_set_type(pn_link_source(readers_), PN_SOURCE);
  pn_terminus_set_address(pn_link_source(readers_), (std::string(readers_topic) + ">").c_str());
  pn_link_open(readers_);
  pn_link_flow(readers_, readers_at_once);
  blocked_ = false;
  for (const auto& outlet : outlets_) {
    outlet->ready = true;
    make_runnable(outlet);
  }
}

void PublishLink::down() {
  readers_ = nullptr;
  blocked_ = false;
  std::size_t again = 0;
  for (UnderWay& entry : under_way_) {
    if (entry.answered || entry.outlet->closed) continue;
    entry.outlet->lost(std::move(entry.outgoing));
    note(entry.outlet);
    ++again;
  }
  under_way_.clear();
  if (blamed()) one_by_one_ = again;
  for (const auto& outlet : runnable_) outlet->in_runnable = false;
  runnable_.clear();
  for (const auto& outlet : outlets_) {
    outlet->disconnected();
    outlet->route = Outlet::Route::unknown;
    note(outlet);
  }
}

void PublishLink::blame(const std::string& why) {
  UnderWay& entry = under_way_.front();
  if (entry.answered || entry.outlet->closed) return;
  logger.error("the server closed the connection when it got a message for {}: {}", entry.outlet->topic.name, why);
  entry.answered = true;
  entry.outlet->refused(entry.outgoing.number, why);
  note(entry.outlet);
  one_by_one_ = 0;
}

void PublishLink::work() {
  fire_timers();
  if (connected()) send_waiting();
}

void PublishLink::report(Lock& lock) {
  if (!reporter_.due()) return;
  reporting_ = std::this_thread::get_id();
  reporter_.report_all(lock);
  reporting_ = {};
}

void PublishLink::note(const std::shared_ptr<Outlet>& outlet) {
  reporter_.note(outlet);
  if (timers_.note(*outlet)) wake();  // whoever sleeps does not know of it
}

void PublishLink::fire_timers() {
  timers_.fire(outlets_, now(), [this](const std::shared_ptr<Outlet>& outlet) {
    reporter_.note(outlet);
    make_runnable(outlet);
  });
  arm(timers_.next());
}

void PublishLink::make_runnable(const std::shared_ptr<Outlet>& outlet) {
  if (outlet->in_runnable || outlet->idle() || !outlet->may_send() || outlet->route == Outlet::Route::asked) return;
  outlet->in_runnable = true;
  runnable_.push_back(outlet);
}

void PublishLink::send_waiting() {
  blocked_ = false;
  while (!runnable_.empty()) {
    if (one_by_one_ > 0 && !under_way_.empty()) return;
    if (pn_link_credit(sender()) <= 0) {
      blocked_ = under_way_.empty();
      return;
    }
    if (pn_session_outgoing_bytes(session()) > buffered) return;  // the loop comes back when the socket took some
    const std::shared_ptr<Outlet> outlet = std::move(runnable_.front());
    runnable_.pop_front();
    outlet->in_runnable = false;
    outlet->expire(now());
    note(outlet);
    if (outlet->idle() || !outlet->may_send()) continue;
    if (outlet->options.own_queue && outlet->route != Outlet::Route::known) {
      outlet->route = Outlet::Route::known;  // the server makes that queue
      outlet->own_queue_exists = true;
      outlet->address = send_address(outlet->topic.name, true);
    } else if (outlet->route == Outlet::Route::unknown || route_is_old(*outlet)) {
      outlet->route = Outlet::Route::asked;
      outlet->asked_at = now();
      find_route(outlet);
      continue;
    }
    Outgoing next = outlet->take_next();
    make_runnable(outlet);  // in turn with the others
    send(outlet, std::move(next));
  }
}

bool PublishLink::route_is_old(const Outlet& outlet) const {
  return !outlet.options.own_queue && now() - outlet.asked_at > route_lasts;
}

void PublishLink::send(const std::shared_ptr<Outlet>& outlet, Outgoing outgoing) {
  Envelope envelope;
  envelope.to = outlet->address;
  envelope.durable = outlet->topic.durable;
  envelope.resent = outgoing.resent || outgoing.old;
  envelope.priority = outlet->options.priority;
  if (outlet->options.deadline.count() > 0) {
    const auto left = outgoing.accepted + outlet->options.deadline - now();
    envelope.expires_in = std::max(std::chrono::milliseconds(1), std::chrono::ceil<std::chrono::milliseconds>(left));
  }
  UnderWay& entry = under_way_.emplace_back(UnderWay{outlet, std::move(outgoing), false});
  head_.clear();
  write_head(entry.outgoing.message, envelope, head_);
  pn_delivery_t* const delivery = send_message(sender(), next_tag(), head_, entry.outgoing.message.payload.text());
  pn_delivery_set_context(delivery, &entry);
}

void PublishLink::find_route(const std::shared_ptr<Outlet>& outlet) {
  ask(queues_pattern(outlet->topic.name),
      [this, outlet](const std::vector<QueueFacts>& queues) { on_route(outlet, queues); });
}

void PublishLink::on_route(const std::shared_ptr<Outlet>& outlet, const std::vector<QueueFacts>& queues) {
  if (outlet->closed) return;
  outlet->own_queue_exists = std::any_of(queues.begin(), queues.end(),
                                         [&](const QueueFacts& queue) { return queue.name == outlet->own_queue; });
  outlet->address = send_address(outlet->topic.name, outlet->own_queue_exists);
  outlet->asked_at = now();
  outlet->route = queues.empty() ? Outlet::Route::unknown : Outlet::Route::known;
  if (queues.empty() && !outlet->idle() && outlet->may_send()) {
    outlet->returned(outlet->take_next(), now());
  }
  note(outlet);
  make_runnable(outlet);
}

void PublishLink::on_message(pn_delivery_t* delivery, const WireBytes& message) {
  pn_delivery_update(delivery, PN_ACCEPTED);
  pn_delivery_settle(delivery);
  if (pn_link_credit(readers_) < readers_at_once / 2) pn_link_flow(readers_, readers_at_once / 2);
  const std::string_view about = read_sections(message.text).to.bytes;
  if (!about.starts_with(readers_topic)) return;
  const std::string_view queue = about.substr(readers_topic.size());
  for (const auto& outlet : outlets_) {
    if (outlet->route == Outlet::Route::known && !outlet->own_queue_exists && outlet->own_queue == queue) {
      outlet->route = Outlet::Route::unknown;
    }
  }
}

void PublishLink::on_outcome(pn_delivery_t* delivery, std::uint64_t outcome) {
  auto* const entry = static_cast<UnderWay*>(pn_delivery_get_context(delivery));
  if (entry == nullptr) return;  // a question's
  entry->answered = true;
  if (one_by_one_ > 0) --one_by_one_;
  Outlet& outlet = *entry->outlet;
  if (!outlet.closed) {
    if (outcome == PN_ACCEPTED) {
      check_order(*entry);
      outlet.confirmed(entry->outgoing.number);
    } else if (outcome == PN_REJECTED) {
      outlet.refused(entry->outgoing.number, "the server rejected it");
    } else {
      outlet.put_off(std::move(entry->outgoing), now());
    }
    note(entry->outlet);
    make_runnable(entry->outlet);
  }
  while (!under_way_.empty() && under_way_.front().answered) under_way_.pop_front();
}

void PublishLink::check_order(const UnderWay& accepted) {
  for (const UnderWay& earlier : under_way_) {
    if (&earlier == &accepted) return;
    if (earlier.answered || earlier.outlet != accepted.outlet) continue;
    meters_.overtook();
    if (std::exchange(said_overtook_, true)) return;
    logger.warn(
        "the server took a message for {} before an earlier one: its memory is full, and unless its flow control is "
        "off "
        "readers get them in that order; <policyEntry queue=\">\" producerFlowControl=\"false\"/> has it keep messages "
        "on "
        "disk instead (brokers/activemq/README.md)",
        accepted.outlet->topic.name);
    return;
  }
}

}  // namespace iotcloud::brokers::activemq
