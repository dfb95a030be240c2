#include "iotcloud/brokers/activemq/sender_link.h"

#include <algorithm>
#include <limits>
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
#include <iotcloud/brokers/activemq/logger.h>

namespace iotcloud::brokers::activemq {
namespace {

// The most bytes that may wait for the socket; further messages stay with their publishers.
constexpr std::size_t buffered = 4U << 20U;
// How long a known route is used. After this time a publisher notices that an operator has deleted the queue.
constexpr std::chrono::seconds route_lasts{10};
// The credit for the server's advisories about readers.
constexpr int readers_at_once = 1000;
// The server's advisory topic, whose messages say which queue has one reader more or less.
constexpr std::string_view readers_topic = "topic://ActiveMQ.Advisory.Consumer.Queue.";

RoutedOutbox& routed(Outbox& outbox) {
  return static_cast<RoutedOutbox&>(outbox);
}

}  // namespace

RoutedOutbox::RoutedOutbox(const Topic& to, const PublisherOptions& how)
    : Outbox(to, how), own_queue(activemq::own_queue(to.name)) {}

SenderLink::SenderLink(IoLoop& loop, const BrokerOptions& options, const std::vector<BrokerUrl>& urls,
                       std::string purpose, Meters& meters, ConnectionLog& log, ServerTrust& trust)
    : SenderCore(*this, meters, clock_of(options)),
      ServerLink(core_.mutex, loop, options, urls, std::move(purpose), log, trust),
      meters_(meters) {}

ConnectionState SenderLink::state() const {
  const config::MutexLock lock(mutex_);
  if (closing_) return ConnectionState::closed;
  if (!connected()) return ConnectionState::connecting;
  return blocked_ ? ConnectionState::blocked : ConnectionState::connected;
}

void SenderLink::added(const std::shared_ptr<Outbox>& outbox) {
  outbox->ready = connected();
  begin();
}

client::PublishTransport::Room SenderLink::room(const std::shared_ptr<Outbox>& outbox, const Message& /*next*/,
                                                bool /*alone*/) {
  assert_held();
  if (!connected()) return Room::full;
  const bool credit = pn_link_credit(sender()) > 0;
  blocked_ = !credit && core_.under_way().empty();
  if (!credit || pn_session_outgoing_bytes(session()) > buffered) return Room::full;
  RoutedOutbox& to = routed(*outbox);
  if (to.options.own_queue && to.route != RoutedOutbox::Route::known) {
    to.route = RoutedOutbox::Route::known;  // the server makes that queue when a message is sent to it
    to.own_queue_exists = true;
    to.address = send_address(to.topic.name, true);
  } else if (to.route == RoutedOutbox::Route::unknown || route_is_old(to)) {
    find_route(outbox);
    return Room::not_for_this_publisher;
  }
  return Room::yes;
}

bool SenderLink::route_is_old(const RoutedOutbox& outbox) const {
  return !outbox.options.own_queue && now() - outbox.asked_at > route_lasts;
}

void SenderLink::send(UnderWay& message) {
  const client::AcceptedMessage& accepted = message.accepted;
  RoutedOutbox& to = routed(*message.outbox);
  Envelope envelope;
  envelope.to = to.address;
  envelope.durable = to.topic.durable;
  envelope.resent = accepted.resent || accepted.old;
  envelope.priority = to.options.priority;
  if (to.options.deadline.count() > 0) {
    const auto left = accepted.accepted_at + to.options.deadline - now();
    envelope.expires_in = std::max(std::chrono::milliseconds(1), std::chrono::ceil<std::chrono::milliseconds>(left));
  }
  head_.clear();
  write_head(accepted.message, envelope, head_);
  pn_delivery_t* const delivery = send_message(sender(), next_tag(), head_, accepted.message.payload.text());
  pn_delivery_set_context(delivery, &message);
}

void SenderLink::send_gathered() {
  if (loop_.gathers()) return;  // messages of quick handlers go out together in flush()
  engine().send();
  if (engine().wants_to_write()) wake();
}

void SenderLink::broke(const char* why) noexcept {
  abandon(why);
}

void SenderLink::left_waiting(const std::shared_ptr<Outbox>& /*outbox*/, Instant /*now*/) {
  if (!connected()) return;
  guarded([this] {
    mutex_.assert_held();
    send_waiting();
  });
}

void SenderLink::want_answers() {
  if (!connected()) return;
  guarded([this] {
    mutex_.assert_held();
    engine().send();
    if (engine().wants_to_write()) wake();
  });
}

void SenderLink::send_waiting() {
  assert_held();
  const PublishCore::Turn turn(core_);
  core_.send_waiting(turn, std::numeric_limits<std::size_t>::max());
}

void SenderLink::up() {
  assert_held();
  // Only advisories from now on matter, because a publisher without readers asks again later anyway.
  readers_ = pn_receiver(session(), "readers");
  pn_terminus_set_type(pn_link_source(readers_), PN_SOURCE);
  pn_terminus_set_address(pn_link_source(readers_), (std::string(readers_topic) + ">").c_str());
  pn_link_open(readers_);
  pn_link_flow(readers_, readers_at_once);
  blocked_ = false;
  for (const auto& outbox : core_.outboxes()) core_.open(outbox);
}

void SenderLink::down() {
  assert_held();
  readers_ = nullptr;
  blocked_ = false;
  core_.connection_lost(blamed());
  for (const auto& outbox : core_.outboxes()) routed(*outbox).route = RoutedOutbox::Route::unknown;
}

std::size_t SenderLink::under_way() const {
  assert_held();
  return core_.under_way().size();
}

void SenderLink::blame(const std::string& why) {
  assert_held();
  UnderWay* const only = core_.the_only_one();
  if (only == nullptr) return;
  logger.error("the server closed the connection when it got a message for {}: {}", only->outbox->topic.name, why);
  core_.refused(*only, why);
}

void SenderLink::work() {
  assert_held();
  core_.fire_timers();
  arm(core_.next_timer());
  if (!connected()) return;
  blocked_ = false;
  send_waiting();
}

void SenderLink::report() {
  assert_held();
  core_.report();
}

void SenderLink::find_route(const std::shared_ptr<Outbox>& outbox) {
  RoutedOutbox& to = routed(*outbox);
  to.route = RoutedOutbox::Route::asked;
  to.ready = false;
  to.asked_at = now();
  ask(queues_pattern(to.topic.name), [this, outbox](const std::vector<QueueFacts>& queues) {
    mutex_.assert_held();
    on_route(outbox, queues);
  });
}

void SenderLink::on_route(const std::shared_ptr<Outbox>& outbox, const std::vector<QueueFacts>& queues) {
  assert_held();
  if (outbox->closed) return;
  RoutedOutbox& to = routed(*outbox);
  to.own_queue_exists =
      std::any_of(queues.begin(), queues.end(), [&](const QueueFacts& queue) { return queue.name == to.own_queue; });
  to.address = send_address(to.topic.name, to.own_queue_exists);
  to.asked_at = now();
  to.route = queues.empty() ? RoutedOutbox::Route::unknown : RoutedOutbox::Route::known;
  to.ready = true;
  if (queues.empty()) {
    core_.nobody_reads(outbox);
  } else {
    core_.make_runnable(outbox);
  }
}

void SenderLink::on_message(pn_delivery_t* delivery, const WireBytes& message) {
  assert_held();
  pn_delivery_update(delivery, PN_ACCEPTED);
  pn_delivery_settle(delivery);
  if (pn_link_credit(readers_) < readers_at_once / 2) pn_link_flow(readers_, readers_at_once / 2);
  const std::string_view about = read_sections(message.text).to.bytes;
  if (!about.starts_with(readers_topic)) return;
  const std::string_view queue = about.substr(readers_topic.size());
  for (const auto& outbox : core_.outboxes()) {
    RoutedOutbox& to = routed(*outbox);
    if (to.route == RoutedOutbox::Route::known && !to.own_queue_exists && to.own_queue == queue) {
      to.route = RoutedOutbox::Route::unknown;
    }
  }
}

void SenderLink::on_outcome(pn_delivery_t* delivery, std::uint64_t outcome) {
  assert_held();
  auto* const message = static_cast<UnderWay*>(pn_delivery_get_context(delivery));
  if (message == nullptr) return;  // the outcome is that of a statistics question
  if (outcome == PN_ACCEPTED) {
    check_order(*message);
    core_.confirmed(*message);
  } else if (outcome == PN_REJECTED) {
    pn_condition_t* const condition = pn_disposition_condition(pn_delivery_remote(delivery));
    const std::string why = describe(condition);
    if (is_final(condition)) {
      logger.error("the server rejected a message for {}: {}", message->outbox->topic.name, why);
      core_.refused(*message, why);
    } else {
      core_.refused_for_now(*message, why);
    }
  } else {
    core_.put_off(*message);
  }
}

void SenderLink::check_order(const UnderWay& accepted) {
  assert_held();
  if (accepted.outbox->closed) return;
  for (const UnderWay& earlier : core_.under_way()) {
    if (&earlier == &accepted) return;
    if (earlier.outbox != accepted.outbox) continue;
    meters_.overtook();
    if (std::exchange(said_overtook_, true)) return;
    logger.warn(
        "the server took a message for {} before an earlier one: its memory is full, and unless its flow control is "
        "off "
        "readers get them in that order; <policyEntry queue=\">\" producerFlowControl=\"false\"/> has it keep messages "
        "on "
        "disk instead (brokers/activemq/README.md)",
        accepted.outbox->topic.name);
    return;
  }
}

}  // namespace iotcloud::brokers::activemq
