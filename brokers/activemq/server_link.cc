#include "iotcloud/brokers/activemq/server_link.h"

#include <algorithm>
#include <utility>

#include <proton/condition.h>
#include <proton/connection.h>
#include <proton/delivery.h>
#include <proton/disposition.h>
#include <proton/link.h>
#include <proton/session.h>
#include <proton/terminus.h>
#include <proton/transport.h>

#include <iotcloud/brokers/activemq/logger.h>

namespace iotcloud::brokers::activemq {
namespace {

constexpr std::chrono::seconds goodbye{1};
/// How many times `rpc_timeout` an answer may take while the server sends something else.
constexpr int times_longer_while_heard = 12;
constexpr int answers_at_once = 1000;

/// The first bytes of a client, which the server answers with the same bytes. Empty under TLS, which would need a
/// handshake first: there an open TCP connection counts as an answer.
std::string greeting_for(const BrokerUrl& url) {
  using namespace std::string_literals;
  return is_tls(url) ? "" : "AMQP\x03\x01\0\0"s;
}

}  // namespace

const config::Clock& clock_of(const BrokerOptions& options) {
  return options.clock != nullptr ? *options.clock : config::system_clock();
}

ServerLink::ServerLink(config::Mutex& mutex, IoLoop& loop, const BrokerOptions& options,
                       const std::vector<BrokerUrl>& urls, std::string purpose, ConnectionLog& log, ServerTrust& trust)
    : loop_(loop),
      options_(options),
      mutex_(mutex),
      urls_(urls),
      purpose_(std::move(purpose)),
      clock_(clock_of(options)),
      log_(log),
      trust_(trust),
      servers_(urls.size()),
      probe_(urls.front().host, port_of(urls.front()), greeting_for(urls.front()), clock_) {}

void ServerLink::start() {
  const config::MutexLock lock(mutex_);
  begin();
}

void ServerLink::begin() {
  if (!std::exchange(started_, true)) wake();
}

void ServerLink::close() {
  const config::MutexLock lock(mutex_);
  closing_ = true;
  wake();
  changed_.wait_until(mutex_, clock_, now() + goodbye, [this]() IOTCLOUD_REQUIRES(mutex_) { return !engine_; });
  if (engine_) lost("the server did not say goodbye");
}

void ServerLink::wake() {
  // The loop ignores a link that has not started. A wake-up before the start would be lost, but would set woken_, which
  // would suppress the one in start().
  if (started_ && !std::exchange(woken_, true)) loop_.wake();
}

IoLoop::Service::Wish ServerLink::wish() {
  const config::MutexLock lock(mutex_);
  Wish wish;
  if (!started_) return wish;
  if (woken_) {
    wish.at = Instant::min();
  } else if (!closing_ || engine_) {
    wish.at = std::min(armed_, next_look_);
  }
  if (engine_) {
    wish.socket = engine_->socket();
    wish.write = engine_->wants_to_write();
  }
  return wish;
}

void ServerLink::serve(bool readable, bool writable) {
  const config::MutexLock lock(mutex_);
  if (!started_ || (!readable && !writable && !woken_ && now() < std::min(armed_, next_look_))) return;
  guarded([&] {
    mutex_.assert_held();
    if (engine_) engine_->receive(readable, writable);
    if (readable) heard_ = now();
    dispatch();
    if (now() >= next_look_ || phase_ == Phase::away) look_after();
    armed_ = Instant::max();
    woken_ = false;
    if (closing_) {
      finish();
    } else {
      work();
    }
    if (engine_) engine_->send();
    dispatch();
  });
  lost_engine_.reset();
  report();
}

void ServerLink::flush() {
  const config::MutexLock lock(mutex_);
  if (phase_ != Phase::up) return;
  guarded([this] {
    mutex_.assert_held();
    before_flush();
    if (engine_) engine_->send();
  });
  if (engine_ && engine_->wants_to_write()) wake();
}

void ServerLink::finish() {
  if (!engine_) return;
  if (phase_ != Phase::up) return lost("closing");
  if (std::exchange(goodbye_said_, true)) return;
  say_goodbye();
  pn_connection_close(engine_->connection());  // the server then closes its end
}

void ServerLink::look_after() {
  next_look_ = now() + look_period;
  if (phase_ == Phase::away) {
    if (closing_) return;
    if (const auto server = servers_.due(now())) {
      attempt(*server);
    } else {
      next_look_ = std::min(next_look_, servers_.next_attempt());
    }
    return;
  }
  if (phase_ != Phase::up) {
    if (now() > attempt_ends_) {
      abandon(phase_ == Phase::connecting
                  ? "no answer"
                  : "no answer to a question about its queues: its activemq.xml needs "
                    "<plugins><statisticsBrokerPlugin/></plugins>, and the user the right to ask");
    }
    return;
  }
  if (!questions_.empty() && has_waited_too_long(questions_.begin()->second.asked)) {
    abandon("no answer to a question about its queues");
    return;
  }
  if (look_after_trust()) look_after_preferred();
}

bool ServerLink::look_after_trust() {
  const std::shared_ptr<ShownChain> shown = engine_->shown();
  if (!shown) return true;
  std::string why;
  {
    const config::Unlocked unlocked(mutex_);  // it may read files
    why = trust_.distrust(*shown, now());
  }
  if (!engine_) return false;
  if (why.empty()) return true;
  lost(why);  // not abandon(): this server gets nothing more, no goodbye either
  return false;
}

/// A busy server answers late, and to connect again would only give it more to do: all messages under way would come
/// once more. So a server that sends anything, if only heartbeats, is waited for longer.
bool ServerLink::has_waited_too_long(Instant asked) const {
  const auto waited = now() - asked;
  const bool silent = now() - heard_ > options_.rpc_timeout;
  return waited > (silent ? 1 : times_longer_while_heard) * options_.rpc_timeout;
}

void ServerLink::look_after_preferred() {
  if (probe_.under_way()) {
    if (const auto answers = probe_.poll()) servers_.asked(*answers, now());
  }
  if (servers_.must_move_back(now())) {
    moving_back_ = true;
    abandon("its preferred server is back");
  } else if (servers_.must_ask(now()) && !probe_.under_way()) {
    const config::Unlocked unlocked(mutex_);  // start() may wait until the host's name is resolved
    probe_.start();
  }
}

void ServerLink::attempt(std::size_t server) {
  server_ = server;
  blamed_ = false;
  phase_ = Phase::connecting;
  attempt_ends_ = now() + options_.rpc_timeout;
  std::unique_ptr<Engine> engine;
  std::string problem;  // for example a missing password file or an unreadable certificate
  {
    const config::Unlocked unlocked(mutex_);
    try {
      engine = std::make_unique<Engine>(options_, urls_[server], purpose_, clock_, trust_);
    } catch (const std::exception& error) {
      problem = error.what();
    }
  }
  if (!engine || closing_) {
    phase_ = Phase::away;
    if (closing_) return;
    log_.failed(problem);
    servers_.failed(server, now());
    return;
  }
  engine_ = std::move(engine);
  pn_connection_open(engine_->connection());
}

void ServerLink::dispatch() {
  while (engine_) {
    pn_event_t* const event = engine_->next_event();
    if (event == nullptr) return;
    handle(event);
  }
}

void ServerLink::handle(pn_event_t* event) {
  switch (pn_event_type(event)) {
    case PN_CONNECTION_REMOTE_OPEN:
      return greet();
    case PN_CONNECTION_REMOTE_CLOSE:
      return on_remote_close();
    case PN_SESSION_REMOTE_OPEN:
      if (pn_event_session(event) != session_) on_session_open(pn_event_session(event));
      return;
    case PN_SESSION_REMOTE_CLOSE:
      return on_session_remote_close(pn_event_session(event));
    case PN_LINK_REMOTE_OPEN:
      if (pn_event_link(event) == answers_) return greeted();
      if (pn_link_is_receiver(pn_event_link(event))) on_receiver_open(pn_event_link(event));
      return;
    case PN_LINK_REMOTE_CLOSE:
    case PN_LINK_REMOTE_DETACH:
      return on_link_remote_close(pn_event_link(event));
    case PN_DELIVERY:
      return on_delivery(pn_event_delivery(event));
    case PN_TRANSPORT_TAIL_CLOSED:
    case PN_TRANSPORT_HEAD_CLOSED:
    case PN_TRANSPORT_CLOSED:
      return lost(describe(pn_transport_condition(engine_->transport())));
    default:
      return;
  }
}

void ServerLink::on_remote_close() {
  pn_condition_t* const condition = pn_connection_remote_condition(engine_->connection());
  const std::string why = describe(condition);
  blamed_ = is_final(condition);
  pn_connection_close(engine_->connection());
  engine_->send();
  lost(why);
}

void ServerLink::on_session_remote_close(pn_session_t* session) {
  const std::string why = describe(pn_session_remote_condition(session));
  if (session == session_) return abandon(why);
  on_session_closed(session, why);
  pn_session_close(session);
  pn_session_free(session);
}

void ServerLink::on_link_remote_close(pn_link_t* link) {
  pn_condition_t* const condition = pn_link_remote_condition(link);
  const std::string why = describe(condition);
  if (link == sender_ || link == answers_) {
    blamed_ = link == sender_ && is_final(condition);
    return abandon(why);
  }
  on_receiver_closed(link, why);
}

void ServerLink::on_delivery(pn_delivery_t* delivery) {
  pn_link_t* const link = pn_delivery_link(delivery);
  if (pn_link_is_sender(link)) {
    const std::uint64_t outcome = pn_delivery_remote_state(delivery);
    if (outcome == 0 && !pn_delivery_settled(delivery)) return pn_delivery_clear(delivery);
    on_outcome(delivery, outcome);
    pn_delivery_settle(delivery);
    return;
  }
  if (pn_delivery_aborted(delivery)) return pn_delivery_settle(delivery);
  if (!pn_delivery_readable(delivery) || pn_delivery_partial(delivery)) return;
  const WireBytes message = receive_message(delivery);
  if (link != answers_) return on_message(delivery, message);
  pn_delivery_update(delivery, PN_ACCEPTED);
  pn_delivery_settle(delivery);
  if (pn_link_credit(answers_) < answers_at_once / 2) pn_link_flow(answers_, answers_at_once / 2);
  answered(message.text);
}

void ServerLink::greet() {
  phase_ = Phase::greeting;
  session_ = pn_session(engine_->connection());
  pn_session_open(session_);
  sender_ = pn_sender(session_, "out");
  pn_terminus_set_type(pn_link_target(sender_), PN_TARGET);  // no address: each message has its own
  pn_link_open(sender_);
  answers_ = pn_receiver(session_, "answers");
  pn_terminus_set_type(pn_link_source(answers_), PN_SOURCE);
  pn_terminus_set_dynamic(pn_link_source(answers_), true);
  pn_link_open(answers_);
  pn_link_flow(answers_, answers_at_once);
}

void ServerLink::greeted() {
  const char* const address = pn_terminus_get_address(pn_link_remote_source(answers_));
  answers_address_ = address == nullptr ? "" : address;
  // A server without the statistics plug-in does not answer, and must not make a queue for the question.
  ask("", [this](const std::vector<QueueFacts>&) {
    mutex_.assert_held();
    phase_ = Phase::up;
    servers_.connected(server_, now());
    log_.connected();
    up();
  });
}

void ServerLink::ask(const std::string& queues, Answer answer) {
  const std::uint64_t number = ++last_question_;
  questions_.emplace(number, Question{{}, std::move(answer), now()});
  send_message(sender_, next_tag(), statistics_question(queues, answers_address_, number), {});
}

void ServerLink::answered(std::string_view message) {
  const StatisticsAnswer answer = statistics_answer(message);
  const auto found = questions_.find(answer.question);
  if (found == questions_.end()) return;
  if (answer.facts) {
    found->second.facts.push_back(*answer.facts);
    return;
  }
  const Question question = std::move(found->second);
  questions_.erase(found);
  question.answer(question.facts);
}

void ServerLink::abandon(const std::string& why) {
  if (!engine_) return;
  pn_connection_close(engine_->connection());
  engine_->send();
  lost(why);
}

void ServerLink::lost(const std::string& why) {
  const Phase was = std::exchange(phase_, Phase::away);
  if (was == Phase::up && blamed_ && under_way() == 1) blame(why);
  down();
  session_ = nullptr;
  sender_ = nullptr;
  answers_ = nullptr;
  questions_.clear();
  lost_engine_ = std::move(engine_);
  wake();
  changed_.notify_all();
  if (closing_) return;
  if (was != Phase::up) {
    log_.failed(why);
    servers_.failed(server_, now());
  } else if (std::exchange(moving_back_, false)) {
    logger.info("{}: going back to the preferred server", purpose_);
    servers_.left();
  } else {
    log_.lost(why);
    servers_.lost(now());
  }
}

}  // namespace iotcloud::brokers::activemq
