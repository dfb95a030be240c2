// What the consuming link does on the I/O thread: sessions, deliveries, settlements.
#include <algorithm>
#include <utility>

#include <proton/connection.hpp>
#include <proton/delivery.hpp>
#include <proton/error_condition.hpp>
#include <proton/message.hpp>
#include <proton/receiver_options.hpp>

#include "iotcloud/brokers/activemq/consume_link.h"
#include "iotcloud/brokers/activemq/wire_message.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::activemq {
namespace {

const config::Logger logger{"brokers.activemq"};

// So many subscriptions are asked for at a time: the others' time for an answer has not begun yet.
constexpr std::size_t opened_at_once = 64;

}  // namespace

void ConsumeLink::up() {
  const Lock lock(mutex_);
  for (const auto& inlet : inlets_) inlet->retry_at = now();
}

void ConsumeLink::down() {
  const Lock lock(mutex_);
  for (const auto& [name, inlet] : open_) {
    forget_session(*inlet);
    inlet->backoff.reset();
  }
  open_.clear();
  leaving_.clear();
  for (const auto& inlet : ready_) inlet->in_ready = false;
  ready_.clear();
  for (const auto& inlet : dirty_) inlet->in_dirty = false;
  dirty_.clear();
}

void ConsumeLink::serve() {
  Lock lock(mutex_);
  if (!connected()) return;
  send_all_settlements();
  for (const auto& inlet : std::exchange(leaving_, {})) leave(*inlet);
  std::optional<Instant> next;
  auto opening = static_cast<std::size_t>(std::count_if(
      inlets_.begin(), inlets_.end(), [](const auto& inlet) { return inlet->phase == Inlet::Phase::opening; }));
  for (const auto& inlet : Inlets(inlets_)) {
    if (inlet->phase == Inlet::Phase::idle && opening >= opened_at_once) continue;
    if (inlet->retry_at && *inlet->retry_at <= now()) {
      if (inlet->phase == Inlet::Phase::opening) {
        lock.unlock();
        abandon("no answer to the request to read " + inlet->queue);
        return;
      }
      inlet->retry_at.reset();
      if (inlet->phase == Inlet::Phase::idle) {
        open(inlet);
        ++opening;
      }
    }
    if (inlet->retry_at && (!next || *inlet->retry_at < *next)) next = inlet->retry_at;
  }
  lock.unlock();
  if (next) arm(*next);
}

void ConsumeLink::say_goodbye() {
  const Lock lock(mutex_);
  send_all_settlements();
}

void ConsumeLink::open(const std::shared_ptr<Inlet>& inlet) {
  inlet->phase = Inlet::Phase::opening;
  inlet->retry_at = now() + options_.rpc_timeout;
  inlet->session = connection().open_session();
  proton::receiver_options options;
  options.name(inlet->name + "." + std::to_string(inlet->generation));
  options.credit_window(0).auto_accept(false);
  open_[inlet->name + "." + std::to_string(inlet->generation)] = inlet;
  inlet->receiver = inlet->session.open_receiver(
      "queue://" + inlet->queue + (inlet->options.exclusive ? "?consumer.exclusive=true" : ""), options);
}

std::shared_ptr<Inlet> ConsumeLink::find(const proton::receiver& receiver) const {
  const auto found = open_.find(receiver.name());
  return found == open_.end() ? nullptr : found->second;
}

void ConsumeLink::on_other_receiver_open(proton::receiver& receiver) {
  const std::shared_ptr<Inlet> inlet = find(receiver);
  if (!inlet) return;
  const std::uint64_t generation = inlet->generation;
  ask(inlet->queue,
      [this, inlet, generation](const std::vector<QueueFacts>& queues) { on_place(inlet, generation, queues); });
}

void ConsumeLink::on_place(const std::shared_ptr<Inlet>& inlet, std::uint64_t generation,
                           const std::vector<QueueFacts>& queues) {
  const Lock lock(mutex_);
  if (inlet->generation != generation || inlet->phase != Inlet::Phase::opening || inlet->closed) return;
  const QueueFacts facts = queues.empty() ? QueueFacts{} : queues.front();
  if (inlet->options.exclusive && facts.readers > 1) {  // stand by
    leave(*inlet);
    retry_later(*inlet);
    return;
  }
  if (inlet->read_before) inlet->doubtful = facts.messages;
  inlet->phase = Inlet::Phase::active;
  inlet->read_before = true;
  inlet->retry_at.reset();
  inlet->backoff.reset();
  inlet->complaint.clear();
  inlet->receiver.add_credit(std::max<std::uint32_t>(inlet->options.prefetch, 1));
  wake();  // the next one may open
}

void ConsumeLink::retry_later(Inlet& inlet) {
  inlet.retry_at = now() + inlet.backoff.next();
  wake();
}

void ConsumeLink::on_other_receiver_error(proton::receiver& receiver) {
  if (const std::shared_ptr<Inlet> inlet = find(receiver)) refused(inlet, receiver.error().what());
}

void ConsumeLink::on_other_session_error(proton::session& session) {
  const auto found =
      std::find_if(open_.begin(), open_.end(), [&](const auto& entry) { return entry.second->session == session; });
  if (found != open_.end()) refused(std::shared_ptr<Inlet>(found->second), session.error().what());
}

void ConsumeLink::refused(const std::shared_ptr<Inlet>& inlet, const std::string& why) {
  const Lock lock(mutex_);
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
  inlet.session.close();
  const std::string name = inlet.receiver.name();
  forget_session(inlet);
  open_.erase(name);
}

void ConsumeLink::forget_session(Inlet& inlet) {
  inlet.phase = Inlet::Phase::idle;
  ++inlet.generation;
  inlet.window.clear();
  inlet.held.clear();
  inlet.first_held = 1;
  inlet.session = {};
  inlet.receiver = {};
}

void ConsumeLink::on_other_message(proton::delivery& delivery, proton::message& message) {
  const std::shared_ptr<Inlet> inlet = find(delivery.receiver());
  if (!inlet) return;
  std::optional<client::Arrived> arrived = from_wire(message);
  const Lock lock(mutex_);
  if (!arrived) {
    if (!std::exchange(inlet->odd_logged, true)) {
      logger.warn(
          "queue {} has messages whose body is neither bytes nor text, or whose properties are no AMQP; they are "
          "rejected",
          inlet->queue);
    }
    delivery.reject();
    inlet->receiver.add_credit(1);
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

void ConsumeLink::send_settlements(Inlet& inlet) {
  std::uint32_t count = 0;
  const auto tell = [&](proton::delivery& delivery, client::AckWindow::Kind kind) {
    if (!delivery) return;
    if (kind == client::AckWindow::Kind::acknowledge) {
      delivery.accept();
    } else {
      delivery.reject();
    }
    delivery = {};
    ++count;
  };
  for (const client::AckWindow::Action& action : inlet.window.take(0)) {
    if (!action.multiple) {
      tell(inlet.held[action.tag - inlet.first_held], action.kind);
      continue;
    }
    for (; inlet.first_held <= action.tag; ++inlet.first_held) {
      tell(inlet.held.front(), action.kind);
      inlet.held.pop_front();
    }
  }
  if (count > 0 && inlet.phase == Inlet::Phase::active && !inlet.closed) inlet.receiver.add_credit(count);
}

void ConsumeLink::send_all_settlements() {
  for (const auto& inlet : std::exchange(dirty_, {})) {
    inlet->in_dirty = false;
    if (inlet->phase == Inlet::Phase::active) send_settlements(*inlet);
  }
}

}  // namespace iotcloud::brokers::activemq
