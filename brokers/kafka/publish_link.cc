#include "iotcloud/brokers/kafka/publish_link.h"

#include <algorithm>
#include <utility>

#include <pthread.h>

#include "iotcloud/brokers/limits.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::kafka {
namespace {

const config::Logger logger{"brokers.kafka"};

bool is_missing_topic(rd_kafka_resp_err_t error) {
  return error == RD_KAFKA_RESP_ERR__UNKNOWN_TOPIC || error == RD_KAFKA_RESP_ERR__UNKNOWN_PARTITION ||
         error == RD_KAFKA_RESP_ERR_UNKNOWN_TOPIC_OR_PART;
}

}  // namespace

PublishLink::PublishLink(KafkaOptions options, Meters& meters, const config::Clock& clock, ConnectionLog& log)
    : options_(std::move(options)), meters_(meters), clock_(clock), log_(log) {
  thread_ = std::thread([this] { run(); });
  pthread_setname_np(thread_.native_handle(), "kafka-publish");
}

PublishLink::~PublishLink() {
  burst_target_->close();
  {
    const Lock lock(mutex_);
    closing_ = true;
  }
  wake_event_.signal();
  thread_.join();
}

std::shared_ptr<Outbox> PublishLink::add(const Topic& topic, const PublisherOptions& options) {
  auto outbox = std::make_shared<Outbox>(topic, options);
  const Lock lock(mutex_);
  outboxes_.push_back(outbox);
  outbox->ready = routes_[topic.name].topic != nullptr;
  if (!outbox->ready) wake();
  return outbox;
}

void PublishLink::remove(const std::shared_ptr<Outbox>& outbox) {
  Lock lock(mutex_);
  std::vector<std::uint64_t> numbers;
  for (const UnderWay& entry : under_way_) {
    if (entry.outbox == outbox) numbers.push_back(entry.outgoing.number);
  }
  outbox->close(numbers);
  std::erase(outboxes_, outbox);
  if (outbox->reporting && std::this_thread::get_id() == thread_.get_id()) return;  // from inside its own callback
  reporter_.report(outbox, lock);
}

PublishStatus PublishLink::publish(const std::shared_ptr<Outbox>& outbox, Message message, const Past& past) {
  const char* why_not = refusal(message);
  const Lock lock(mutex_);
  if (outbox->closed) return PublishStatus::closed;
  const Instant now = clock_.now();
  if (why_not != nullptr) {
    const Outgoing refused = outbox->accept(std::move(message), now);
    outbox->sent_directly();
    outbox->refused(refused.number, why_not);
    note(outbox);
    wake();
    return PublishStatus::accepted;
  }
  outbox->expire(now);
  note(outbox);
  if (outbox->has_report()) wake();
  if (!outbox->has_room()) {
    outbox->refuse_room();
    return PublishStatus::would_block;
  }
  Outgoing outgoing = outbox->accept(std::move(message), now, past);
  Route& route = routes_[outbox->topic.name];
  Burst* const burst = burst_for(*outbox, route);
  if (burst == nullptr && outbox->idle() && outbox->may_send() && may_send() && takes_one(route)) {
    outbox->sent_directly();
    route.handed_over_at = now;
    UnderWay& entry = add_under_way(outbox, route, std::move(outgoing));
    prepare(entry);
    if (const auto error = hand_over(entry, route.topic.get(), {now, clock_.wall_ms()});
        error != RD_KAFKA_RESP_ERR_NO_ERROR) {
      settle(entry, error);
    }
    if (reporter_.due()) wake();
    return PublishStatus::accepted;
  }
  outbox->add_waiting(std::move(outgoing));
  const bool timed = note(outbox);
  make_runnable(outbox, route);
  // What waits for an answer goes on when that comes.
  if (burst != nullptr && outbox->in_runnable) burst->add(burst_target_, now);
  const bool now_runs = burst == nullptr && outbox->in_runnable && may_send() && takes_wave(route, now);
  if (timed || outbox->has_report() || now_runs) wake();
  return PublishStatus::accepted;
}

bool PublishLink::drain(const std::shared_ptr<Outbox>& outbox, std::chrono::milliseconds limit) {
  Lock lock(mutex_);
  return reporter_.drain(outbox, limit, lock);
}

std::size_t PublishLink::pending(const Outbox& outbox) const {
  const Lock lock(mutex_);
  return outbox.pending();
}

ConnectionState PublishLink::state() const {
  const Lock lock(mutex_);
  if (closing_) return ConnectionState::closed;
  return connected_ ? ConnectionState::connected : ConnectionState::connecting;
}

void PublishLink::wake() {
  if (!std::exchange(sleeping_, false)) return;
  wake_event_.signal();
}

void PublishLink::settle(UnderWay& entry, rd_kafka_resp_err_t error) {
  const std::shared_ptr<Outbox> outbox = std::move(entry.outbox);
  Route& route = *entry.route;
  Outgoing outgoing = std::move(entry.outgoing);
  answered(route);
  under_way_.erase(entry.self);
  if (error == RD_KAFKA_RESP_ERR_NO_ERROR) send_backoff_.reset();
  if (outbox->closed) return;
  if (error == RD_KAFKA_RESP_ERR_NO_ERROR) {
    outbox->confirmed(outgoing.number);
  } else if (is_refusal(error)) {
    logger.error("a message for topic {} was refused: {}", outbox->topic.name, rd_kafka_err2str(error));
    outbox->refused(outgoing.number, rd_kafka_err2name(error));
  } else if (error == RD_KAFKA_RESP_ERR__QUEUE_FULL) {
    full_ = true;
    outbox->lost(std::move(outgoing));
  } else {
    if (is_missing_topic(error)) {
      route.made = false;
      route.topic.reset();
      for (const auto& other : outboxes_) {
        if (other->topic.name == outbox->topic.name) other->ready = false;
      }
    }
    outbox->disconnected();  // what is under way behind it ends first, so that nothing overtakes
    outbox->ready = route.topic != nullptr;
    outbox->lost(std::move(outgoing));
    if (!broken_ && send_again_at_ == Instant{}) send_again_at_ = clock_.now() + send_backoff_.next();
  }
  note(outbox);
  make_runnable(outbox, route);
}

bool PublishLink::is_refusal(rd_kafka_resp_err_t error) {
  switch (error) {
    case RD_KAFKA_RESP_ERR_MSG_SIZE_TOO_LARGE:
    case RD_KAFKA_RESP_ERR_RECORD_LIST_TOO_LARGE:
    case RD_KAFKA_RESP_ERR_INVALID_MSG:
    case RD_KAFKA_RESP_ERR_INVALID_MSG_SIZE:
    case RD_KAFKA_RESP_ERR_INVALID_RECORD:
    case RD_KAFKA_RESP_ERR_INVALID_TIMESTAMP:
    case RD_KAFKA_RESP_ERR_POLICY_VIOLATION:
    case RD_KAFKA_RESP_ERR_TOPIC_EXCEPTION:
    case RD_KAFKA_RESP_ERR_TOPIC_AUTHORIZATION_FAILED:
    case RD_KAFKA_RESP_ERR_CLUSTER_AUTHORIZATION_FAILED:
    case RD_KAFKA_RESP_ERR__INVALID_ARG:
      return true;
    default:
      return false;
  }
}

std::chrono::milliseconds PublishLink::time_to_sleep(Instant now) {
  const bool sure = connected_ && doubted_at_ == Instant{};
  std::chrono::milliseconds limit = sure ? std::chrono::milliseconds(1000) : look_again;
  const auto until = [&](Instant instant) {
    limit =
        std::clamp(std::chrono::ceil<std::chrono::milliseconds>(instant - now), std::chrono::milliseconds(0), limit);
  };
  watching_ = last_burst_ != Instant{} && now - last_burst_ < bursts_again;
  if (watching_) limit = std::min(limit, watch_period);
  if (send_again_at_ != Instant{}) until(send_again_at_);
  if (!under_way_.empty()) limit = std::min(limit, longest_wait);
  if (may_send()) {
    for (const Route* route : runnable_) until(opens_at(*route));
  }
  if (!asked_.empty() || !connected_) {
    // The answer wakes us.
  } else if (std::any_of(routes_.begin(), routes_.end(), [](const auto& route) { return !route.second.topic; })) {
    until(ask_topics_at_);
  }
  timers_.fire(outboxes_, now, [&](const std::shared_ptr<Outbox>& outbox) {
    reporter_.note(outbox);
    limit = std::chrono::milliseconds(0);
  });
  if (timers_.next() != Instant::max()) until(timers_.next());
  return limit;
}

bool PublishLink::note(const std::shared_ptr<Outbox>& outbox) {
  reporter_.note(outbox);
  return timers_.note(*outbox);
}

}  // namespace iotcloud::brokers::kafka
