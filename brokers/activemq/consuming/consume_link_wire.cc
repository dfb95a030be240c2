// What the consuming link says to the server and hears from it: sessions, deliveries, settlements.
#include <algorithm>
#include <utility>

#include <proton/connection.h>
#include <proton/delivery.h>
#include <proton/disposition.h>
#include <proton/link.h>
#include <proton/session.h>
#include <proton/terminus.h>

#include "iotcloud/brokers/activemq/consuming/consume_link.h"
#include "iotcloud/brokers/activemq/wire/wire_message.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::activemq {
namespace {

const config::Logger logger{"brokers.activemq"};

// So many subscriptions are asked for at a time: the others' time for an answer has not begun yet.
constexpr std::size_t opened_at_once = 64;
// A subscription's credit is given back when that part of it has been used: each time costs a frame.
constexpr std::uint32_t credit_parts = 4;

}  // namespace

void ConsumeLink::up() {
  for (const auto& inlet : inlets_) try_at(*inlet, now());
}

void ConsumeLink::down() {
  for (const Inlets* const inlets : {&inlets_, &leaving_}) {
    for (const auto& inlet : *inlets) {
      if (inlet->phase == Inlet::Phase::idle) continue;
      forget_session(*inlet);
      inlet->backoff.reset();
    }
  }
  leaving_.clear();
  to_ask_.clear();
  for (const auto& inlet : ready_) inlet->in_ready = false;
  ready_.clear();
  for (const auto& inlet : dirty_) inlet->in_dirty = false;
  dirty_.clear();
}

void ConsumeLink::work() {
  if (!connected()) return;
  send_all_settlements();
  for (const auto& inlet : std::exchange(leaving_, {})) leave(*inlet);
  ask_for_places();
  if (now() >= next_try_) open_due();
  arm(next_try_);
}

void ConsumeLink::try_at(Inlet& inlet, Instant when) {
  inlet.retry_at = when;
  next_try_ = std::min(next_try_, when);
  wake();
}

void ConsumeLink::open_due() {
  next_try_ = Instant::max();
  for (const auto& inlet : inlets_) {
    if (!inlet->retry_at) continue;
    if (*inlet->retry_at > now()) {
      next_try_ = std::min(next_try_, *inlet->retry_at);
    } else if (inlet->phase == Inlet::Phase::opening) {
      return abandon("no answer to the request to read " + inlet->queue);
    } else if (opening_ < opened_at_once) {
      open(inlet);
      next_try_ = std::min(next_try_, *inlet->retry_at);
    }  // otherwise activate() and leave() come back to it
  }
}

void ConsumeLink::open(const std::shared_ptr<Inlet>& inlet) {
  inlet->phase = Inlet::Phase::opening;
  ++opening_;
  inlet->retry_at = now() + options_.rpc_timeout;
  inlet->session = pn_session(engine().connection());
  pn_session_set_context(inlet->session, inlet.get());
  pn_session_open(inlet->session);
  const std::string name = inlet->name + "." + std::to_string(inlet->generation);
  inlet->receiver = pn_receiver(inlet->session, name.c_str());
  pn_link_set_context(inlet->receiver, inlet.get());
  const std::string source = "queue://" + inlet->queue + (inlet->options.exclusive ? "?consumer.exclusive=true" : "");
  pn_terminus_set_type(pn_link_source(inlet->receiver), PN_SOURCE);
  pn_terminus_set_address(pn_link_source(inlet->receiver), source.c_str());
  pn_link_open(inlet->receiver);
}

void ConsumeLink::on_receiver_open(pn_link_t* receiver) {
  auto* const known = static_cast<Inlet*>(pn_link_get_context(receiver));
  if (known == nullptr) return;
  if (pn_terminus_get_type(pn_link_remote_source(receiver)) == PN_UNSPECIFIED) return;  // refused: the reason follows
  if (!known->options.exclusive && !known->read_before) return activate(*known);
  to_ask_.push_back(known->shared_from_this());
}

void ConsumeLink::ask_for_places() {
  if (to_ask_.empty()) return;
  std::string queues;
  for (const auto& inlet : to_ask_) queues += (queues.empty() ? "" : ",") + inlet->queue;
  std::vector<std::uint64_t> generations;
  for (const auto& inlet : to_ask_) generations.push_back(inlet->generation);
  ask(queues, [this, inlets = std::exchange(to_ask_, {}), generations](const std::vector<QueueFacts>& all) {
    for (std::size_t i = 0; i < inlets.size(); ++i) {
      const auto facts =
          std::find_if(all.begin(), all.end(), [&](const QueueFacts& one) { return one.name == inlets[i]->queue; });
      on_place(inlets[i], generations[i], facts == all.end() ? QueueFacts() : *facts);
    }
  });
}

void ConsumeLink::on_place(const std::shared_ptr<Inlet>& inlet, std::uint64_t generation, const QueueFacts& facts) {
  if (inlet->generation != generation || inlet->phase != Inlet::Phase::opening || inlet->closed) return;
  if (inlet->options.exclusive && facts.readers > 1) {  // stand by
    leave(*inlet);
    retry_later(*inlet);
    return;
  }
  if (inlet->read_before) inlet->doubtful = facts.messages;
  activate(*inlet);
}

void ConsumeLink::activate(Inlet& inlet) {
  inlet.phase = Inlet::Phase::active;
  --opening_;
  next_try_ = Instant::min();  // the next one may open
  inlet.read_before = true;
  inlet.retry_at.reset();
  inlet.backoff.reset();
  inlet.complaint.clear();
  inlet.owed = 0;
  pn_link_flow(inlet.receiver, std::max<int>(inlet.options.prefetch, 1));
}

void ConsumeLink::retry_later(Inlet& inlet) {
  try_at(inlet, now() + inlet.backoff.next());
}

void ConsumeLink::on_receiver_closed(pn_link_t* receiver, const std::string& why) {
  refused(static_cast<Inlet*>(pn_link_get_context(receiver)), why);
}

void ConsumeLink::on_session_closed(pn_session_t* session, const std::string& why) {
  refused(static_cast<Inlet*>(pn_session_get_context(session)), why);
}

void ConsumeLink::refused(Inlet* known, const std::string& why) {
  if (known == nullptr) return;
  const std::shared_ptr<Inlet> inlet = known->shared_from_this();
  const bool was_active = inlet->phase == Inlet::Phase::active;
  leave(*inlet);
  if (inlet->closed) return;
  retry_later(*inlet);
  const std::string complaint =
      (was_active ? "was closed by the server; trying again: " : "cannot be read; trying again: ") + why;
  if (std::exchange(inlet->complaint, complaint) != complaint) logger.warn("queue {} {}", inlet->queue, complaint);
}

void ConsumeLink::leave(Inlet& inlet) {
  if (inlet.phase == Inlet::Phase::idle) return;
  send_settlements(inlet);
  pn_link_set_context(inlet.receiver, nullptr);
  pn_session_set_context(inlet.session, nullptr);
  pn_session_close(inlet.session);  // freed when the server has closed it, too
  forget_session(inlet);
}

void ConsumeLink::forget_session(Inlet& inlet) {
  if (inlet.phase == Inlet::Phase::opening) {
    --opening_;
    next_try_ = Instant::min();
  }
  inlet.phase = Inlet::Phase::idle;
  ++inlet.generation;
  inlet.window.clear();
  inlet.held.clear();
  inlet.first_held = 1;
  inlet.session = nullptr;
  inlet.receiver = nullptr;
}

void ConsumeLink::on_message(pn_delivery_t* delivery, const WireBytes& message) {
  auto* const known = static_cast<Inlet*>(pn_link_get_context(pn_delivery_link(delivery)));
  if (known == nullptr) return pn_delivery_settle(delivery);  // its session is being closed: it goes back
  const std::shared_ptr<Inlet> inlet = known->shared_from_this();
  std::optional<client::Arrived> arrived = from_wire(message);
  if (!arrived) {
    if (!std::exchange(inlet->odd_logged, true)) {
      logger.warn("queue {} has messages whose body is neither bytes nor text, or that are no AMQP; they are rejected",
                  inlet->queue);
    }
    meters_.skipped("undecodable");
    pn_delivery_update(delivery, PN_REJECTED);
    pn_delivery_settle(delivery);
    give_credit(*inlet, 1);
    return;
  }
  if (!arrived->redelivered && inlet->doubtful > 0) {
    --inlet->doubtful;
    arrived->redelivered = true;
  }
  arrived->tag = inlet->first_held + inlet->held.size();
  inlet->held.push_back(delivery);
  inlet->window.delivered(std::move(*arrived));
  make_ready(inlet);
}

void ConsumeLink::give_credit(Inlet& inlet, std::uint32_t count) {
  inlet.owed += count;
  if (inlet.owed == 0 || inlet.owed < inlet.options.prefetch / credit_parts) return;
  pn_link_flow(inlet.receiver, static_cast<int>(std::exchange(inlet.owed, 0)));
}

void ConsumeLink::send_settlements(Inlet& inlet) {
  std::uint32_t count = 0;
  const auto tell = [&](pn_delivery_t* delivery, client::AckWindow::Kind kind) {
    if (delivery == nullptr) return;
    pn_delivery_update(delivery, kind == client::AckWindow::Kind::acknowledge ? PN_ACCEPTED : PN_REJECTED);
    pn_delivery_settle(delivery);
    ++count;
  };
  for (const client::AckWindow::Action& action : inlet.window.take(0)) {
    if (!action.multiple) {
      tell(std::exchange(inlet.held[action.tag - inlet.first_held], nullptr), action.kind);
      continue;
    }
    for (; inlet.first_held <= action.tag; ++inlet.first_held) {
      tell(inlet.held.front(), action.kind);
      inlet.held.pop_front();
    }
  }
  if (inlet.phase == Inlet::Phase::active && !inlet.closed) give_credit(inlet, count);
}

void ConsumeLink::send_all_settlements() {
  for (const auto& inlet : std::exchange(dirty_, {})) {
    inlet->in_dirty = false;
    if (inlet->phase == Inlet::Phase::active) send_settlements(*inlet);
  }
}

}  // namespace iotcloud::brokers::activemq
