// What the thread of the publishing link does.
#include <algorithm>
#include <exception>
#include <utility>

#include "iotcloud/brokers/kafka/publish_link.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::kafka {
namespace {

const config::Logger logger{"brokers.kafka"};

constexpr std::chrono::seconds end_limit{2};  // for the library to give back what it has

Settings producer_settings() {
  return {
      {"enable.idempotence", "true"},
      {"acks", "all"},
      {"linger.ms", "0"},
      {"message.timeout.ms", "0"},  // never: what it has it sends again until it is confirmed
      // The publishers' own capacities are the limit.
      {"queue.buffering.max.messages", "2147483647"},
      {"queue.buffering.max.kbytes", "2147483647"},
      // The key alone decides, and as in the original's Java client.
      {"partitioner", "murmur2_random"},
  };
}

}  // namespace

void PublishLink::run() {
  Lock lock(mutex_);
  while (!closing_) {
    lock.unlock();
    try {
      if (!client_) start_client();
    } catch (const std::exception& error) {  // ClientError, config::Error: no client for now
      log_.failed(error.what());
      next_attempt_ = clock_.now() + std::chrono::seconds(1);
    }
    lock.lock();
    // In this order: what was said of a connection before it was there again is not taken for its loss.
    serve_events(lock);
    if (client_) look_for_servers();
    if (broken_) {
      lock.unlock();
      end_client(last_error_);
      lock.lock();
    }
    const Instant now = clock_.now();
    if (send_again_at_ != Instant{} && send_again_at_ <= now) send_again_at_ = {};
    ask_for_topics(now);
    look_for_topics(lock);
    send_waiting(lock);
    reporter_.report_all(lock);
    const std::chrono::milliseconds limit = time_to_sleep(clock_.now());
    if (reporter_.due() || closing_) continue;
    sleeping_ = true;
    lock.unlock();
    wake_event_.wait(-1, false, limit);
    lock.lock();
    sleeping_ = false;
  }
  connected_ = false;
  broken_ = true;
  lock.unlock();
  if (client_) end_client("");
}

void PublishLink::start_client() {
  if (clock_.now() < next_attempt_) return;
  auto made = std::make_shared<Client>(RD_KAFKA_PRODUCER, options_, producer_settings(),
                                       RD_KAFKA_EVENT_DR | RD_KAFKA_EVENT_ERROR);
  Queue events(rd_kafka_queue_get_main(made->get()));
  constexpr std::uint64_t one = 1;
  rd_kafka_queue_io_event_enable(events.get(), wake_event_.descriptor(), &one, sizeof(one));
  const Lock lock(mutex_);
  client_ = std::move(made);
  events_ = std::move(events);
  broken_ = full_ = connected_ = false;
  doubted_at_ = {};
}

void PublishLink::end_client(const std::string& reason) {
  if (!reason.empty()) logger.error("the Kafka producer cannot go on: {}; starting another", reason);
  // Everything it has comes back in reports that say so.
  rd_kafka_purge(client_->get(), RD_KAFKA_PURGE_F_QUEUE | RD_KAFKA_PURGE_F_INFLIGHT);
  const auto end = std::chrono::steady_clock::now() + end_limit;
  Lock lock(mutex_);
  while (!under_way_.empty() && std::chrono::steady_clock::now() < end) {
    lock.unlock();
    wake_event_.wait(-1, false, std::chrono::milliseconds(10));
    lock.lock();
    serve_events(lock);
  }
  connected_ = false;
  asked_.clear();
  for (auto& [name, route] : routes_) {
    route.made = false;
    route.topic.reset();
  }
  for (const auto& outbox : outboxes_) outbox->disconnected();
  rd_kafka_queue_io_event_enable(events_.get(), -1, nullptr, 0);
  events_.reset();
  std::shared_ptr<Client> gone = std::move(client_);
  next_attempt_ = clock_.now();
  lock.unlock();
  gone.reset();
  lock.lock();
  // What the library did not give back in time is ours again now that it has ended.
  while (!under_way_.empty()) settle(under_way_.front(), RD_KAFKA_RESP_ERR__DESTROY);
}

void PublishLink::lose_connection() {
  if (!std::exchange(connected_, false)) return;
  log_.lost(last_error_.empty() ? "no answer" : last_error_);
}

void PublishLink::look_for_servers() {
  if (connected_ && doubted_at_ == Instant{}) return;
  const bool connected = client_->connected();
  if (!connected) client_->refresh_credentials(options_);
  if (!connected && connected_ && clock_.now() - doubted_at_ < longest_doubt) return;
  doubted_at_ = {};
  if (!connected && !connected_ && !last_error_.empty()) log_.failed(last_error_);
  if (!connected) return lose_connection();
  if (std::exchange(connected_, true)) return;
  last_error_.clear();
  log_.connected();
  for (const auto& outbox : outboxes_) make_runnable(outbox);
}

void PublishLink::serve_events(Lock& lock) {
  while (events_) {
    lock.unlock();
    const Event event(rd_kafka_queue_poll(events_.get(), 0));
    lock.lock();
    if (!event) return;
    on_event(event.get());
  }
}

void PublishLink::on_event(rd_kafka_event_t* event) {
  switch (rd_kafka_event_type(event)) {
    case RD_KAFKA_EVENT_DR:
      while (const rd_kafka_message_t* report = rd_kafka_event_message_next(event)) on_report(*report);
      return;
    case RD_KAFKA_EVENT_ERROR:
      on_error(event);
      return;
    case RD_KAFKA_EVENT_CREATETOPICS_RESULT:
      on_topics(event);
      return;
    default:
      return;
  }
}

void PublishLink::on_report(const rd_kafka_message_t& report) {
  full_ = false;
  settle(*static_cast<UnderWay*>(report._private), report.err);
}

void PublishLink::on_error(rd_kafka_event_t* event) {
  const rd_kafka_resp_err_t error = rd_kafka_event_error(event);
  if (rd_kafka_event_error_is_fatal(event) != 0) {
    last_error_ = rd_kafka_event_error_string(event);
    broken_ = true;
    return;
  }
  if (!is_about_connection(error)) {
    logger.debug("{}", rd_kafka_event_error_string(event));
    return;
  }
  if (error != RD_KAFKA_RESP_ERR__ALL_BROKERS_DOWN || last_error_.empty()) {
    last_error_ = lasting_words(event);
  }
  if (error == RD_KAFKA_RESP_ERR__ALL_BROKERS_DOWN) {
    lose_connection();
  } else if (doubted_at_ == Instant{}) {
    doubted_at_ = clock_.now();
  }
}

void PublishLink::ask_for_topics(Instant now) {
  if (!connected_ || !asked_.empty() || now < ask_topics_at_) return;
  for (const auto& [name, route] : routes_) {
    if (!route.topic && !route.made) asked_.push_back(name);
  }
  if (!asked_.empty()) request_topics(*client_, events_.get(), asked_, options_);
}

void PublishLink::on_topics(rd_kafka_event_t* event) {
  for (const MadeTopic& made : made_topics(event, asked_)) {
    Route& route = routes_[made.name];
    if (!made.complaint.empty() && std::exchange(route.complaint, made.complaint) != made.complaint) {
      logger.warn("cannot make the topic {}: {}; {}", made.name, made.complaint,
                  made.there ? "using it if it is there" : "trying again");
    }
    if (!made.there) {
      ask_topics_at_ = clock_.now() + topic_backoff_.next();
      continue;
    }
    route.made = true;
  }
  asked_.clear();
}

void PublishLink::look_for_topics(Lock& lock) {
  if (!connected_ || !asked_.empty() || clock_.now() < ask_topics_at_) return;
  std::vector<std::string> names;
  for (const auto& [name, route] : routes_) {
    if (route.made && !route.topic) names.push_back(name);
  }
  for (const std::string& name : names) {
    lock.unlock();
    const bool known = client_->knows(name, options_.broker.rpc_timeout);
    lock.lock();
    if (!known) {
      routes_[name].made = false;  // so it is asked for again
      ask_topics_at_ = clock_.now() + topic_backoff_.next();
      return;
    }
    topic_backoff_.reset();
    Route& route = routes_[name];
    if (rd_kafka_topic_t* made = rd_kafka_topic_new(client_->get(), name.c_str(), nullptr)) {
      route.topic.reset(made, TopicDestroyer());
    }
    for (const auto& outbox : outboxes_) {
      if (outbox->topic.name != name) continue;
      outbox->ready = route.topic != nullptr;
      make_runnable(outbox);
    }
  }
}

}  // namespace iotcloud::brokers::kafka
