#include "iotcloud/brokers/kafka/producer.h"

#include <algorithm>
#include <exception>
#include <limits>
#include <utility>

#include <fmt/format.h>
#include <pthread.h>

#include "iotcloud/brokers/envelope.h"
#include "iotcloud/brokers/kafka/record.h"
#include <iotcloud/brokers/kafka/logger.h>
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::kafka {
namespace {

using std::chrono::milliseconds;

constexpr std::chrono::seconds end_limit{2};  // how long the library may take to give back its messages
constexpr milliseconds void_look_pause{100};

Settings producer_settings() {
  return {
      {"enable.idempotence", "true"},
      {"acks", "all"},
      {"linger.ms", "0"},
      {"message.timeout.ms", "0"},  // never: the library sends a message again until it is confirmed
      // No limit here: the publishers' capacities limit the messages.
      {"queue.buffering.max.messages", "2147483647"},
      {"queue.buffering.max.kbytes", "2147483647"},
      // The key alone decides, in the same way as in the original system's Java client.
      {"partitioner", "murmur2_random"},
  };
}

bool is_missing_topic(rd_kafka_resp_err_t error) {
  return error == RD_KAFKA_RESP_ERR__UNKNOWN_TOPIC || error == RD_KAFKA_RESP_ERR__UNKNOWN_PARTITION ||
         error == RD_KAFKA_RESP_ERR_UNKNOWN_TOPIC_OR_PART;
}

/// Whether the same message, alone in its request, would get this error again whenever it is sent.
bool is_refusal_for_good(rd_kafka_resp_err_t error) {
  switch (error) {
    case RD_KAFKA_RESP_ERR_MSG_SIZE_TOO_LARGE:
    case RD_KAFKA_RESP_ERR_RECORD_LIST_TOO_LARGE:
    case RD_KAFKA_RESP_ERR_INVALID_MSG_SIZE:
    case RD_KAFKA_RESP_ERR_INVALID_RECORD:
    case RD_KAFKA_RESP_ERR_TOPIC_EXCEPTION:
    case RD_KAFKA_RESP_ERR__INVALID_ARG:
      return true;
    default:
      return false;
  }
}

/// Whether the error is about a request as a whole: any of its messages may be the cause, or their number.
bool is_about_request(rd_kafka_resp_err_t error) {
  switch (error) {
    case RD_KAFKA_RESP_ERR_MSG_SIZE_TOO_LARGE:
    case RD_KAFKA_RESP_ERR_RECORD_LIST_TOO_LARGE:
    case RD_KAFKA_RESP_ERR_INVALID_MSG_SIZE:
    case RD_KAFKA_RESP_ERR_INVALID_RECORD:
      return true;
    default:
      return false;
  }
}

/// Whether the servers refuse this publisher's messages for a reason that may pass: a permission that is missing, a
/// policy, clocks that do not agree. An error of the connection or of the whole cluster is no such refusal.
bool is_refusal_for_now(rd_kafka_resp_err_t error) {
  switch (error) {
    case RD_KAFKA_RESP_ERR_TOPIC_AUTHORIZATION_FAILED:
    case RD_KAFKA_RESP_ERR_CLUSTER_AUTHORIZATION_FAILED:
    case RD_KAFKA_RESP_ERR_POLICY_VIOLATION:
    case RD_KAFKA_RESP_ERR_INVALID_TIMESTAMP:
      return true;
    default:
      return false;
  }
}

/// The library's report of a message, as an error or none. A server names the offset of what it stores. A success
/// without one is a conclusion of the library's from the success of a later message, and may be wrong (see
/// FirstMessages; a server also forgets producers that have sent nothing to a partition for a day).
rd_kafka_resp_err_t outcome_of(const rd_kafka_message_t& report) {
  if (report.err != RD_KAFKA_RESP_ERR_NO_ERROR || report.offset >= 0) return report.err;
  logger.warn(
      "topic {}, partition {}: librdkafka {} takes a message for stored whose place no server has named; it is "
      "sent again",
      rd_kafka_topic_name(report.rkt), report.partition, rd_kafka_version_str());
  return RD_KAFKA_RESP_ERR__GAPLESS_GUARANTEE;
}

TopicLane& lane_of(const Outbox& outbox) {
  return static_cast<TopicLane&>(*outbox.lane);
}

}  // namespace

Producer::Producer(KafkaOptions options, Meters& meters, const config::Clock& clock, ConnectionLog& log)
    : options_(std::move(options)),
      clock_(clock),
      log_(log),
      core_(*this, meters, clock),
      renewal_(options_,
               [this] {
                 return std::make_shared<KafkaClient>(RD_KAFKA_PRODUCER, options_, producer_settings(),
                                                      RD_KAFKA_EVENT_DR | RD_KAFKA_EVENT_ERROR);
               }),
      gathering_target_(std::make_shared<Gathering::Target>([this] { end_gathering(); })) {
  thread_ = std::thread([this] { run(); });
  pthread_setname_np(thread_.native_handle(), "kafka-publish");
}

Producer::~Producer() {
  gathering_target_->close();
  {
    const config::MutexLock lock(core_.mutex);
    closing_ = true;
  }
  wake_event_.signal();
  thread_.join();
}

ConnectionState Producer::state() const {
  const config::MutexLock lock(core_.mutex);
  if (closing_) return ConnectionState::closed;
  return connected_ ? ConnectionState::connected : ConnectionState::connecting;
}

void Producer::added(const std::shared_ptr<Outbox>& outbox) {
  TopicLane& lane = topics_.lane(outbox->topic.name);
  outbox->lane = &lane;
  outbox->ready = lane.topic != nullptr;
  if (!outbox->ready) wake();
}

bool Producer::may_send() const {
  return connected_ && !broken_ && !full_ && renew_by_ == Instant{} && send_again_at_ == Instant{};
}

Gathering* Producer::gathering_for(const Outbox& outbox, const TopicLane& lane) const {
  Gathering* const gathering = Gathering::of_this_thread();
  if (gathering == nullptr || lane.under_way > 0) return gathering;
  return watching_ && (gathering->more_follow() || !outbox.idle()) ? gathering : nullptr;
}

client::PublishTransport::Room Producer::room(const std::shared_ptr<Outbox>& outbox, const Message& next, bool alone) {
  if (!may_send()) return Room::full;
  TopicLane& lane = lane_of(*outbox);
  const std::size_t body = next.payload.size();
  if (alone) {
    if (gathering_for(*outbox, lane) != nullptr || !lane.takes_one()) return Room::full;
  } else if (wave_.empty()) {
    if (!lane.takes_wave(clock_.now())) return Room::full;
    wave_bytes_ = 0;
  } else if (wave_.size() >= lane.most_in_wave() || wave_bytes_ + body > TopicLane::most_bytes_in_wave) {
    return Room::full;
  }
  if (!lane.first_messages.takes(next.driver_id, clock_)) return Room::full;
  wave_bytes_ += body;
  return Room::yes;
}

void Producer::left_waiting(const std::shared_ptr<Outbox>& outbox, Instant now) {
  const TopicLane& lane = lane_of(*outbox);
  // Messages that wait for an answer go on when it arrives.
  if (Gathering* const gathering = gathering_for(*outbox, lane)) {
    gathering->add(gathering_target_, now);
  } else if (may_send() && lane.takes_wave(now)) {
    wake();
  }
}

void Producer::send(UnderWay& message) {
  lane_of(*message.outbox).sent(message.accepted.message.driver_id, clock_);
  wave_.push_back(&message);
}

void Producer::send_alone(UnderWay& message) {
  TopicLane& lane = lane_of(*message.outbox);
  const Now now{clock_.now(), clock_.wall_ms()};
  lane.sent(message.accepted.message.driver_id, clock_);
  lane.handed_over_at = now.instant;
  prepare(message);
  const rd_kafka_resp_err_t error = hand_over(message, client_->get(), lane.topic.get(), now);
  if (error != RD_KAFKA_RESP_ERR_NO_ERROR) settle(message, error);
}

void Producer::send_gathered() {
  const std::vector<UnderWay*> wave = std::exchange(wave_, {});
  TopicLane& lane = lane_of(*wave.front()->outbox);
  const std::shared_ptr<rd_kafka_topic_t> topic = lane.topic;
  rd_kafka_t* const producer = client_->get();
  const Now now{clock_.now(), clock_.wall_ms()};
  lane.handed_over_at = now.instant;
  Failed failed;
  {
    // Without the mutex publishers go on, and delivery reports may arrive; the client is not replaced, because this
    // thread has the Turn.
    const config::Unlocked unlocked(core_.mutex);
    failed = hand_over_all(wave, producer, topic.get(), now);
  }
  lane.handed_over_at = clock_.now();
  for (const auto& [message, error] : failed) settle(*message, error);
}

void Producer::prepare(UnderWay& message) const {
  if (!options_.native_headers) message.encoded = encode_envelope(message.accepted.message);
}

rd_kafka_resp_err_t Producer::hand_over(UnderWay& message, rd_kafka_t* producer, rd_kafka_topic_t* topic,
                                        const Now& now) const {
  const client::AcceptedMessage& accepted = message.accepted;
  RecordMarks marks;
  marks.resent = accepted.resent || accepted.old;
  if (const auto deadline = message.outbox->options.deadline; deadline.count() > 0) {
    const auto left = accepted.accepted_at + deadline - now.instant;
    marks.expires_ms = now.wall_ms + std::max<std::int64_t>(1, std::chrono::ceil<milliseconds>(left).count());
  }
  return produce(producer, topic, accepted.message, marks, options_.native_headers, now.wall_ms, message.encoded,
                 &message);
}

Producer::Failed Producer::hand_over_all(const std::vector<UnderWay*>& wave, rd_kafka_t* producer,
                                         rd_kafka_topic_t* topic, const Now& now) const {
  // Prepare all messages before the library gets the first one: when its thread wakes up, it sends what it has by then.
  for (UnderWay* const message : wave) prepare(*message);
  Failed failed;
  for (UnderWay* const message : wave) {
    // Later messages of the same publisher must not overtake a failed one, which has to wait.
    const auto before = std::find_if(failed.begin(), failed.end(), [&](const auto& other) {
      return other.first->outbox == message->outbox && !is_refusal_for_good(other.second);
    });
    const auto error = before != failed.end() ? before->second : hand_over(*message, producer, topic, now);
    if (error != RD_KAFKA_RESP_ERR_NO_ERROR) failed.emplace_back(message, error);
  }
  return failed;
}

// The cause is lack of memory: the library reports its errors as values.
void Producer::broke(const char* why) noexcept {
  logger.error("cannot send: {}", why);
}

void Producer::wake() noexcept {
  if (std::exchange(sleeping_, false)) wake_event_.signal();
}

void Producer::send_waiting() {
  if (!may_send()) return;
  const PublishCore::Turn turn(core_);
  core_.send_waiting(turn, std::numeric_limits<std::size_t>::max());
}

void Producer::end_gathering() {
  const config::MutexLock lock(core_.mutex);
  last_gathering_ = clock_.now();
  send_waiting();
  if (core_.report_due()) wake();
}

void Producer::settle(UnderWay& message, rd_kafka_resp_err_t error, bool in_company) {
  const std::shared_ptr<Outbox> outbox = message.outbox;
  TopicLane& lane = lane_of(*outbox);
  const bool stored = error == RD_KAFKA_RESP_ERR_NO_ERROR;
  lane.answered(message.accepted.message.driver_id, stored, clock_.now());
  if (!in_company && (stored || is_refusal_for_good(error))) lane.settled_alone(stored);
  if (stored) {
    send_backoff_.reset();
    client_backoff_.reset();
    complaint_.clear();
    core_.confirmed(message);
  } else if (outbox->closed) {
    core_.lost(message);
  } else if (in_company && is_about_request(error)) {
    lane.refused_in_company();
    set_back_.emplace(&lane, message.accepted.message.driver_id);
    core_.refused_for_now(message, fmt::format("{} ({}), sent together; each is sent alone now",
                                               rd_kafka_err2name(error), rd_kafka_err2str(error)));
  } else if (is_refusal_for_good(error)) {
    logger.error("a message for topic {} was refused: {}", outbox->topic.name, rd_kafka_err2str(error));
    core_.refused(message, rd_kafka_err2name(error));
  } else if (is_refusal_for_now(error)) {
    core_.refused_for_now(message, rd_kafka_err2str(error));
  } else if (error == RD_KAFKA_RESP_ERR__QUEUE_FULL) {
    full_ = true;
    core_.lost(message);
  } else {
    if (is_missing_topic(error)) {
      ProducerTopics::gone(lane);
      for (const auto& other : core_.outboxes()) {
        if (other->lane == &lane) other->ready = false;
      }
    }
    core_.failed(message);
    if (!broken_ && send_again_at_ == Instant{}) send_again_at_ = clock_.now() + send_backoff_.next();
  }
}

void Producer::run() {
  const config::MutexLock lock(core_.mutex);
  while (!closing_) {
    if (!client_) start_client();
    // First the events, then the check for servers: otherwise an old event about a failed connection would count as a
    // loss of the new one.
    serve_events();
    if (client_) look_for_overtaking();
    if (client_) look_for_servers();
    if (client_ && broken_) end_client(last_error_);
    if (client_) look_for_void();
    if (client_) look_for_renewal();
    const Instant now = clock_.now();
    if (send_again_at_ != Instant{} && send_again_at_ <= now) send_again_at_ = {};
    if (connected_) topics_.ask(*client_, events_.get(), options_, now);
    look_for_topics();
    send_waiting();
    core_.report();
    const milliseconds limit = time_to_sleep();
    if (core_.report_due() || closing_) continue;
    sleeping_ = true;
    {
      const config::Unlocked unlocked(core_.mutex);
      wake_event_.wait(-1, false, limit);
    }
    sleeping_ = false;
  }
  connected_ = false;
  broken_ = true;
  if (client_) end_client("");
}

void Producer::start_client() {
  if (clock_.now() < next_attempt_) return;
  std::shared_ptr<KafkaClient> made;
  Queue events;
  try {
    const config::Unlocked unlocked(core_.mutex);
    made = renewal_.client();
    events.reset(rd_kafka_queue_get_main(made->get()));
    constexpr std::uint64_t one = 1;
    rd_kafka_queue_io_event_enable(events.get(), wake_event_.descriptor(), &one, sizeof(one));
  } catch (const std::exception& error) {  // ClientError, config::Error: try to make the client later
    log_.failed(error.what());
    next_attempt_ = clock_.now() + client_backoff_.next();
    return;
  }
  client_ = std::move(made);
  events_ = std::move(events);
  broken_ = full_ = connected_ = false;
  doubted_at_ = renew_by_ = {};
}

void Producer::end_client(const std::string& reason) {
  if (!reason.empty() && std::exchange(complaint_, reason) != reason) {
    logger.error("the Kafka producer cannot go on: {}; starting another, until one can", reason);
  }
  connected_ = false;
  // After the purge every message in the library gets a delivery report with an error.
  {
    rd_kafka_t* const producer = client_->get();
    const config::Unlocked unlocked(core_.mutex);  // the call waits for the library's threads
    rd_kafka_purge(producer, RD_KAFKA_PURGE_F_QUEUE | RD_KAFKA_PURGE_F_INFLIGHT);
  }
  const Instant end = clock_.now() + end_limit;
  while (!core_.under_way().empty() && clock_.now() < end) {
    {
      const config::Unlocked unlocked(core_.mutex);
      wake_event_.wait(-1, false, milliseconds(10));
    }
    serve_events();
  }
  rd_kafka_queue_io_event_enable(events_.get(), -1, nullptr, 0);
  std::shared_ptr<KafkaClient> gone;
  {
    const PublishCore::Turn turn(core_);  // another thread may be handing over a wave
    topics_.forget();
    events_.reset();
    gone = std::move(client_);
  }
  next_attempt_ = clock_.now() + client_backoff_.next();
  {
    const config::Unlocked unlocked(core_.mutex);
    gone.reset();
  }
  // Messages that the library did not report in time: they are no longer under way, because the client has ended.
  for (const UnderWay& message : core_.under_way()) lane_of(*message.outbox).forgotten();
  core_.connection_lost(false);
  set_back_.clear();
}

/// Takes back what the library has when some of it would overtake earlier messages of its driver, which were refused in
/// company and wait again. Another client sends it after them.
void Producer::look_for_overtaking() {
  if (set_back_.empty()) return;
  const auto set_back = std::exchange(set_back_, {});
  const auto overtakes = [&](const UnderWay& message) {
    return set_back.contains({&lane_of(*message.outbox), message.accepted.message.driver_id});
  };
  const auto& under_way = core_.under_way();
  if (std::none_of(under_way.begin(), under_way.end(), overtakes)) return;
  broken_ = true;
  end_client("");
}

/// Takes back what the library has and has not stored yet when some of it became void (PublisherOptions::void_before):
/// the process stood still, or lost its place, and the library would send it as soon as it can. What is not void is
/// sent again by another client.
void Producer::look_for_void() {
  const Instant now = clock_.now();
  if (now < next_void_look_) return;
  next_void_look_ = now + void_look_pause;
  const auto is_void = [](const UnderWay& message) {
    const auto& void_before = message.outbox->options.void_before;
    return void_before && !message.outbox->closed && message.accepted.accepted_at < void_before();
  };
  const auto& under_way = core_.under_way();
  if (std::none_of(under_way.begin(), under_way.end(), is_void)) return;
  logger.warn(
      "messages that librdkafka has not delivered are void by now: they are taken back, and another producer goes on");
  broken_ = true;
  end_client("");
}

void Producer::lose_connection() {
  if (!std::exchange(connected_, false)) return;
  log_.lost(last_error_.empty() ? "no answer" : last_error_);
}

void Producer::look_for_servers() {
  if (connected_ && doubted_at_ == Instant{}) return;
  bool connected = false;
  {
    const std::shared_ptr<KafkaClient> client = client_;
    const config::Unlocked unlocked(core_.mutex);  // without the mutex, because it may read a password file
    connected = client->connected();
    if (!connected) client->refresh_credentials(options_, clock_.now());
  }
  if (!connected && connected_ && clock_.now() - doubted_at_ < longest_doubt) return;
  doubted_at_ = {};
  if (!connected && !connected_ && !last_error_.empty()) log_.failed(last_error_);
  if (!connected) return lose_connection();
  if (std::exchange(connected_, true)) return;
  last_error_.clear();
  log_.connected();
  for (const auto& outbox : core_.outboxes()) core_.make_runnable(outbox);
}

void Producer::look_for_renewal() {
  bool ready = false;
  {
    const config::Unlocked unlocked(core_.mutex);  // without the mutex, because it may read files
    ready = renewal_.ready(clock_.now());
  }
  const Instant now = clock_.now();
  if (!ready) {
    renew_by_ = {};
  } else if (renew_by_ == Instant{}) {
    renew_by_ = now + end_limit;
  }
  // What the present client has must be answered first: otherwise the next one might send it twice, and later messages
  // before it. A client without a server gets no answers.
  if (!ready || (connected_ && now < renew_by_ && !core_.under_way().empty())) return;
  end_client("");
  client_backoff_.reset();
  next_attempt_ = {};
  start_client();
}

void Producer::serve_events() {
  while (events_) {
    Event event;
    {
      rd_kafka_queue_t* const events = events_.get();
      const config::Unlocked unlocked(core_.mutex);
      event.reset(rd_kafka_queue_poll(events, 0));
    }
    if (!event) return;
    on_event(event.get());
    if (!set_back_.empty() && !broken_) return;  // look_for_overtaking() must come soon
  }
}

void Producer::on_event(rd_kafka_event_t* event) {
  switch (rd_kafka_event_type(event)) {
    case RD_KAFKA_EVENT_DR:
      while (const rd_kafka_message_t* report = rd_kafka_event_message_next(event)) {
        full_ = false;
        UnderWay& message = *static_cast<UnderWay*>(report->_private);
        settle(message, outcome_of(*report), lane_of(*message.outbox).in_company);
      }
      return;
    case RD_KAFKA_EVENT_ERROR:
      return on_error(event);
    case RD_KAFKA_EVENT_CREATETOPICS_RESULT:
      return topics_.on_answer(event, clock_.now());
    default:
      return;
  }
}

void Producer::on_error(rd_kafka_event_t* event) {
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

void Producer::look_for_topics() {
  if (!connected_) return;
  for (const std::string& name : topics_.unseen(clock_.now())) {
    const std::shared_ptr<KafkaClient> client = client_;
    int partitions = 0;
    {
      const config::Unlocked unlocked(core_.mutex);
      partitions = client->partitions(name, options_.broker.rpc_timeout);
    }
    if (partitions == 0) return topics_.not_there(name, clock_.now());
    topics_.there(name, partitions, *client);
    const TopicLane& lane = topics_.lane(name);
    if (!lane.topic) continue;
    for (const auto& outbox : core_.outboxes()) {
      if (outbox->lane == &lane) core_.open(outbox);
    }
  }
}

milliseconds Producer::time_to_sleep() {
  const Instant now = clock_.now();
  const bool sure = connected_ && doubted_at_ == Instant{};
  milliseconds limit = sure ? milliseconds(1000) : look_again;
  const auto until = [&](Instant instant) {
    if (instant == Instant::max()) return;
    limit = std::clamp(std::chrono::ceil<milliseconds>(instant - now), milliseconds(0), limit);
  };
  watching_ = last_gathering_ != Instant{} && now - last_gathering_ < gathers_again;
  if (watching_) limit = std::min(limit, watch_period);
  if (send_again_at_ != Instant{}) until(send_again_at_);
  if (!core_.under_way().empty()) limit = std::min(limit, TopicLane::longest_wait);
  if (may_send()) {
    for (const client::PublishLane* const lane : core_.waiting_lanes()) {
      const auto& topic = static_cast<const TopicLane&>(*lane);
      until(topic.under_way == 0 ? now : topic.opens_at());
    }
  }
  if (connected_) until(topics_.next_look());
  if (renewal_.pending()) limit = std::min(limit, look_again);
  if (core_.fire_timers()) return milliseconds(0);
  until(core_.next_timer());
  return limit;
}

}  // namespace iotcloud::brokers::kafka
