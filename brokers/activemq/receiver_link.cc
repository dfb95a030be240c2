#include "iotcloud/brokers/activemq/receiver_link.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <utility>

#include <proton/connection.h>
#include <proton/delivery.h>
#include <proton/disposition.h>
#include <proton/link.h>
#include <proton/session.h>
#include <proton/terminus.h>

#include "iotcloud/brokers/activemq/names.h"
#include "iotcloud/brokers/activemq/wire/wire_message.h"
#include <iotcloud/brokers/activemq/logger.h>

namespace iotcloud::brokers::activemq {
namespace {

// The most handlers in a row before the sockets are checked, or as many as fit into the time below.
constexpr int handlers_in_a_row = 32;
constexpr std::chrono::microseconds time_in_a_row{1000};
// Messages that a handler sends are held back to be sent together only if the handler before it took less than this.
constexpr std::chrono::microseconds quick{50};

// The most subscriptions requested at a time. The time limit for an answer starts with the request, so it has not begun
// for the others.
constexpr std::size_t opened_at_once = 64;
// Credit is renewed when this fraction (1/n) of it has been used, because each renewal costs a frame.
constexpr std::uint32_t credit_parts = 4;

std::shared_ptr<SessionReader> shared(SessionReader& reader) {
  return std::static_pointer_cast<SessionReader>(reader.shared_from_this());
}

}  // namespace

SessionReader::SessionReader(std::shared_ptr<ReceiverLink> link, std::string link_name, Topic to,
                             SubscriptionOptions how, Handler what)
    : OwnDeliveryStream(std::move(to), std::move(how), std::move(what)),
      name(std::move(link_name)),
      queue(queue_of(topic.name, options.group)),
      link_(std::move(link)) {}

void SessionReader::settle(std::uint64_t tag, Settlement settlement) noexcept {
  link_->settle(*this, tag, settlement);
}

ReceiverLink::ReceiverLink(IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
                           std::string purpose, Meters& meters, ConnectionLog& log, ServerTrust& trust)
    : ReceiverCore(*this, meters, clock_of(options)),
      ServerLink(core_.mutex, loop, options, urls, std::move(purpose), log, trust),
      meters_(meters) {}

void ReceiverLink::end() {
  {
    const config::MutexLock lock(mutex_);
    assert_held();
    core_.stop();
  }
  close();
  // Readers own their link, so the link must drop its references to them, or neither would be destroyed.
  const config::MutexLock lock(mutex_);
  assert_held();
  core_.connection_lost();
  leaving_.clear();
}

std::shared_ptr<SessionReader> ReceiverLink::add(const Topic& topic, const SubscriptionOptions& options,
                                                 Handler handler) {
  const config::MutexLock lock(mutex_);
  auto reader = std::make_shared<SessionReader>(shared_from_this(), "r" + std::to_string(++last_name_), topic, options,
                                                std::move(handler));
  readers_.push_back(reader);
  try_at(*reader, now());
  begin();
  return reader;
}

void ReceiverLink::remove(const std::shared_ptr<SessionReader>& reader) {
  const config::MutexLock lock(mutex_);
  assert_held();
  core_.end(*reader);
  std::erase(readers_, reader);
  leaving_.push_back(reader);
  wake();
  core_.await_handler(*reader);
}

void ReceiverLink::pause(SessionReader& reader) {
  const config::MutexLock lock(mutex_);
  assert_held();
  core_.pause(reader);
}

bool ReceiverLink::raise_prefetch(SessionReader& reader, std::uint16_t prefetch) {
  if (prefetch > reader.options.prefetch_limit) return false;
  const config::MutexLock lock(mutex_);
  assert_held();
  if (prefetch <= reader.prefetch) return true;
  if (reader.phase == SessionReader::Phase::active) {
    reader.owed += static_cast<std::uint32_t>(prefetch - reader.prefetch);
    core_.make_dirty(reader);
    wake();
  }
  reader.prefetch = prefetch;
  return true;
}

void ReceiverLink::resume(SessionReader& reader) {
  const config::MutexLock lock(mutex_);
  assert_held();
  core_.resume(reader);
}

bool ReceiverLink::active(const SessionReader& reader) const {
  const config::MutexLock lock(mutex_);
  return reader.phase == SessionReader::Phase::active;
}

ConnectionState ReceiverLink::state() const {
  const config::MutexLock lock(mutex_);
  if (closing_) return ConnectionState::closed;
  return !started_ || connected() ? ConnectionState::connected : ConnectionState::connecting;
}

void ReceiverLink::settle(SessionReader& reader, std::uint64_t public_tag, Settlement settlement) noexcept {
  const config::MutexLock lock(mutex_);
  assert_held();
  core_.settle(reader, public_tag, settlement);
}

void ReceiverLink::settled(client::DeliveryStream& /*stream*/, bool /*first*/) noexcept {
  assert_held();
  // The serving thread sends settlements after the handlers that it runs; otherwise wake it.
  if (!(loop_.serves() && core_.hands_on_here())) wake();
}

bool ReceiverLink::has_handlers_to_run() {
  const config::MutexLock lock(mutex_);
  assert_held();
  return core_.has_ready() && !core_.hands_on();
}

void ReceiverLink::run_handlers() {
  const config::MutexLock lock(mutex_);
  assert_held();
  ReadCore::Turn turn(core_);
  if (!turn) return;
  const Instant begin = now();
  Instant last = begin;
  bool was_quick = true;
  for (int count = 0;; ++count) {
    const bool serves = loop_.serves();
    if (serves && (count >= handlers_in_a_row || last - begin > time_in_a_row)) break;
    if (core_.take(turn) == nullptr) break;
    loop_.gather(serves && was_quick && core_.has_ready());
    core_.run(turn);
    const Instant after = now();
    was_quick = after - std::exchange(last, after) < quick;
    if (was_quick || !loop_.serves()) continue;
    const config::Unlocked unlocked(mutex_);
    loop_.flush();
  }
  loop_.gather(false);
  if (core_.has_ready()) wake();
}

void ReceiverLink::up() {
  for (const auto& reader : readers_) try_at(*reader, now());
}

void ReceiverLink::down() {
  for (const SessionReaders* const readers : {&readers_, &leaving_}) {
    for (const auto& reader : *readers) {
      if (reader->phase == SessionReader::Phase::idle) continue;
      forget_session(*reader);
      reader->backoff.reset();
    }
  }
  leaving_.clear();
  to_ask_.clear();
  assert_held();
  core_.connection_lost();
}

void ReceiverLink::work() {
  if (!connected()) return;
  send_all_settlements();
  const bool some_leave = !leaving_.empty();
  for (const auto& reader : std::exchange(leaving_, {})) leave(*reader);
  ask_for_places();
  // Proton writes the begin frames of new sessions before the end frames of old ones. A server that meets a queue's
  // next reader before the last reader has left may reorder the messages that the last reader had. So the end frames
  // are written first.
  if (some_leave) return wake();
  if (now() >= next_try_) open_due();
  arm(next_try_);
}

void ReceiverLink::try_at(SessionReader& reader, Instant when) {
  reader.retry_at = when;
  next_try_ = std::min(next_try_, when);
  wake();
}

void ReceiverLink::open_due() {
  next_try_ = Instant::max();
  for (const auto& reader : readers_) {
    if (!reader->retry_at) continue;
    if (*reader->retry_at > now()) {
      next_try_ = std::min(next_try_, *reader->retry_at);
    } else if (reader->phase != SessionReader::Phase::idle) {
      if (has_waited_too_long(reader->asked_at)) return abandon("no answer to the request to read " + reader->queue);
      reader->retry_at = now() + look_period;
      next_try_ = std::min(next_try_, *reader->retry_at);
    } else if (opening_ < opened_at_once) {
      if (reader->stands_by) {
        ask_first(reader);
      } else {
        open(reader);
      }
      next_try_ = std::min(next_try_, *reader->retry_at);
    }  // otherwise activate() or leave() sets next_try_
  }
}

void ReceiverLink::ask_first(const std::shared_ptr<SessionReader>& reader) {
  reader->phase = SessionReader::Phase::asking;
  ++opening_;
  reader->asked_at = now();
  reader->retry_at = reader->asked_at + look_period;
  to_ask_.push_back(reader);
}

void ReceiverLink::open(const std::shared_ptr<SessionReader>& reader) {
  reader->phase = SessionReader::Phase::opening;
  ++opening_;
  reader->asked_at = now();
  reader->retry_at = reader->asked_at + look_period;
  reader->session = pn_session(engine().connection());
  pn_session_set_context(reader->session, reader.get());
  pn_session_open(reader->session);
  const std::string name = reader->name + "." + std::to_string(reader->generation);
  reader->receiver = pn_receiver(reader->session, name.c_str());
  pn_link_set_context(reader->receiver, reader.get());
  const std::string source = "queue://" + reader->queue + (reader->options.exclusive ? "?consumer.exclusive=true" : "");
  pn_terminus_set_type(pn_link_source(reader->receiver), PN_SOURCE);
  pn_terminus_set_address(pn_link_source(reader->receiver), source.c_str());
  pn_link_open(reader->receiver);
}

void ReceiverLink::on_receiver_open(pn_link_t* receiver) {
  auto* const known = static_cast<SessionReader*>(pn_link_get_context(receiver));
  if (known == nullptr) return;
  // Refused: the server sends the reason next.
  if (pn_terminus_get_type(pn_link_remote_source(receiver)) == PN_UNSPECIFIED) return;
  if (!known->options.exclusive && !known->read_before) return activate(*known);
  to_ask_.push_back(shared(*known));
}

void ReceiverLink::ask_for_places() {
  if (to_ask_.empty()) return;
  std::string queues;
  for (const auto& reader : to_ask_) queues += (queues.empty() ? "" : ",") + reader->queue;
  std::vector<std::uint64_t> generations;
  for (const auto& reader : to_ask_) generations.push_back(reader->generation);
  ask(queues, [this, readers = std::exchange(to_ask_, {}), generations](const std::vector<QueueFacts>& all) {
    mutex_.assert_held();
    for (std::size_t i = 0; i < readers.size(); ++i) {
      const auto facts =
          std::find_if(all.begin(), all.end(), [&](const QueueFacts& one) { return one.name == readers[i]->queue; });
      on_place(readers[i], generations[i], facts == all.end() ? QueueFacts() : *facts);
    }
  });
}

void ReceiverLink::on_place(const std::shared_ptr<SessionReader>& reader, std::uint64_t generation,
                            const QueueFacts& facts) {
  if (reader->generation != generation || reader->closed) return;
  if (reader->phase == SessionReader::Phase::asking) {
    leave(*reader);
    reader->stands_by = facts.readers > 0;
    if (reader->stands_by) return retry_later(*reader);
    return try_at(*reader, now());
  }
  if (reader->phase != SessionReader::Phase::opening) return;
  if (reader->options.exclusive && facts.readers > 1) {  // another reader has the queue: stand by
    leave(*reader);
    reader->stands_by = true;
    return retry_later(*reader);
  }
  if (reader->read_before) reader->doubtful = facts.messages;
  activate(*reader);
}

void ReceiverLink::activate(SessionReader& reader) {
  reader.phase = SessionReader::Phase::active;
  --opening_;
  next_try_ = Instant::min();  // the next subscription may be requested
  reader.read_before = true;
  reader.retry_at.reset();
  reader.backoff.reset();
  reader.complaint.clear();
  reader.owed = 0;
  pn_link_flow(reader.receiver, std::max<int>(reader.prefetch, 1));
}

void ReceiverLink::retry_later(SessionReader& reader) {
  try_at(reader, now() + reader.backoff.next());
}

void ReceiverLink::on_receiver_closed(pn_link_t* receiver, const std::string& why) {
  refused(static_cast<SessionReader*>(pn_link_get_context(receiver)), why);
}

void ReceiverLink::on_session_open(pn_session_t* session) {
  if (pn_session_get_context(session) == nullptr) pn_session_close(session);
}

void ReceiverLink::on_session_closed(pn_session_t* session, const std::string& why) {
  refused(static_cast<SessionReader*>(pn_session_get_context(session)), why);
}

void ReceiverLink::refused(SessionReader* known, const std::string& why) {
  if (known == nullptr) return;
  const std::shared_ptr<SessionReader> reader = shared(*known);
  const bool was_active = reader->phase == SessionReader::Phase::active;
  leave(*reader);
  if (reader->closed) return;
  retry_later(*reader);
  const std::string complaint =
      (was_active ? "was closed by the server; trying again: " : "cannot be read; trying again: ") + why;
  if (std::exchange(reader->complaint, complaint) != complaint) logger.warn("queue {} {}", reader->queue, complaint);
}

void ReceiverLink::leave(SessionReader& reader) {
  if (reader.phase == SessionReader::Phase::idle) return;
  if (reader.phase == SessionReader::Phase::asking) return forget_session(reader);
  send_settlements(reader);
  pn_link_set_context(reader.receiver, nullptr);
  pn_session_set_context(reader.session, nullptr);
  // The session is freed when the server has closed its end, too. If the server has not opened its end yet,
  // on_session_open() closes the session later: closed now, it would free the number of its channel for the next
  // session, and the server's answers to this session would be taken for answers to that one.
  if ((pn_session_state(reader.session) & PN_REMOTE_UNINIT) == 0) pn_session_close(reader.session);
  forget_session(reader);
}

void ReceiverLink::forget_session(SessionReader& reader) {
  if (reader.phase != SessionReader::Phase::active) {
    --opening_;
    next_try_ = Instant::min();
  }
  reader.phase = SessionReader::Phase::idle;
  reader.begin_anew();
  reader.held.clear();
  reader.first_held = 1;
  reader.session = nullptr;
  reader.receiver = nullptr;
}

void ReceiverLink::on_message(pn_delivery_t* delivery, const WireBytes& message) {
  auto* const known = static_cast<SessionReader*>(pn_link_get_context(pn_delivery_link(delivery)));
  // Its session is being closed, and the server delivers the message again.
  if (known == nullptr) return pn_delivery_settle(delivery);
  const std::shared_ptr<SessionReader> reader = shared(*known);
  std::optional<client::Arrived> arrived = from_wire(message);
  if (!arrived) {
    if (!std::exchange(reader->odd_logged, true)) {
      logger.warn("queue {} has messages whose body is neither bytes nor text, or that are no AMQP; they are rejected",
                  reader->queue);
    }
    meters_.skipped("undecodable");
    pn_delivery_update(delivery, PN_REJECTED);
    pn_delivery_settle(delivery);
    give_credit(*reader, 1);
    return;
  }
  if (!arrived->redelivered && reader->doubtful > 0) {
    --reader->doubtful;
    arrived->redelivered = true;
  }
  arrived->tag = reader->first_held + reader->held.size();
  reader->held.push_back(delivery);
  assert_held();
  // Cannot fail: this function made the tag, which is the next one.
  static_cast<void>(core_.arrived(*reader, std::move(*arrived)));
}

void ReceiverLink::give_credit(SessionReader& reader, std::uint32_t count) {
  reader.owed += count;
  if (reader.owed == 0 || reader.owed < reader.options.prefetch / credit_parts) return;
  pn_link_flow(reader.receiver, static_cast<int>(std::exchange(reader.owed, 0)));
}

void ReceiverLink::send_settlements(SessionReader& reader) {
  std::uint32_t count = 0;
  const auto tell = [&](pn_delivery_t* delivery, client::AckWindow::Kind kind) {
    if (delivery == nullptr) return;
    pn_delivery_update(delivery, kind == client::AckWindow::Kind::acknowledge ? PN_ACCEPTED : PN_REJECTED);
    pn_delivery_settle(delivery);
    ++count;
  };
  for (const client::AckWindow::Action& action : reader.window.take(0)) {
    if (!action.multiple) {
      tell(std::exchange(reader.held[action.tag - reader.first_held], nullptr), action.kind);
      continue;
    }
    for (; reader.first_held <= action.tag; ++reader.first_held) {
      tell(reader.held.front(), action.kind);
      reader.held.pop_front();
    }
  }
  if (reader.phase == SessionReader::Phase::active && !reader.closed) give_credit(reader, count);
}

void ReceiverLink::send_all_settlements() {
  assert_held();
  for (const auto& stream : core_.take_dirty()) {
    auto& reader = static_cast<SessionReader&>(*stream);
    if (reader.phase == SessionReader::Phase::active) send_settlements(reader);
  }
}

}  // namespace iotcloud::brokers::activemq
