// How messages reach the library.
//
// An idempotent producer of librdkafka 2.0 (and later ones) has one request of a partition under way once five messages
// of it are (its issue 4989: it counts messages where it means requests). What it is given meanwhile it keeps, and
// until the answer comes its thread polls without sleeping, because with a linger of 0 that is due. So it gets single
// messages only while fewer than five are under way. Otherwise messages wait here, and go together when all is
// answered: then that is one request for each partition, as long as its messages are handed over before that thread
// wakes up. A partition that still had something under way would keep the thread awake, which then cuts what the others
// are being given into several requests, keeps what is left, and polls on. For a partition whose server does not answer
// the others of its topic wait no longer than longest_wait.
//
// Each request costs client and server many times what a message in it does. So what a handler's thread publishes goes
// in one wave when the thread has handled what came together. A handler may run for long, or wait for an outcome: so a
// message is kept back only where the link's thread looks soon anyway, for an answer or because there were bursts.
#include <algorithm>
#include <utility>

#include "iotcloud/brokers/kafka/publish_link.h"
#include "iotcloud/brokers/kafka/record.h"

namespace iotcloud::brokers::kafka {
namespace {

constexpr std::size_t most_singles = 5;  // RD_KAFKA_IDEMP_MAX_INFLIGHT
// Of one wave: below the library's batch.size (1 MB), so that it is one request.
constexpr std::size_t most_in_wave = 1024;
constexpr std::size_t most_in_slow_wave = 4096;
constexpr std::chrono::milliseconds slow_answer{2};
constexpr std::size_t most_bytes_in_wave = 900'000;

}  // namespace

bool PublishLink::may_send() const {
  return connected_ && !broken_ && !full_ && send_again_at_ == Instant{};
}

bool PublishLink::takes_one(const Route& route) const {
  return route.under_way < most_singles && route.runnable.empty() && !route.in_wave;
}

bool PublishLink::takes_wave(const Route& route, Instant now) const {
  return !route.in_wave && (route.under_way == 0 || now >= opens_at(route));
}

Instant PublishLink::opens_at(const Route& route) {
  return route.handed_over_at + longest_wait;
}

void PublishLink::answered(Route& route) {
  if (--route.under_way == 0) route.answered_slowly = clock_.now() - route.handed_over_at > slow_answer;
}

void PublishLink::make_runnable(const std::shared_ptr<Outbox>& outbox) {
  make_runnable(outbox, routes_[outbox->topic.name]);
}

void PublishLink::make_runnable(const std::shared_ptr<Outbox>& outbox, Route& route) {
  if (outbox->in_runnable || outbox->idle() || !outbox->may_send()) return;
  outbox->in_runnable = true;
  route.runnable.push_back(outbox);
  if (!std::exchange(route.in_runnable, true)) runnable_.push_back(&route);
}

PublishLink::UnderWay& PublishLink::add_under_way(const std::shared_ptr<Outbox>& outbox, Route& route,
                                                  Outgoing outgoing) {
  UnderWay& entry = under_way_.emplace_back(UnderWay{outbox, &route, std::move(outgoing), {}, {}});
  entry.self = std::prev(under_way_.end());
  ++route.under_way;
  return entry;
}

void PublishLink::prepare(UnderWay& entry) const {
  if (!options_.native_headers) entry.envelope = encode_envelope(entry.outgoing.message);
}

rd_kafka_resp_err_t PublishLink::hand_over(UnderWay& entry, rd_kafka_topic_t* topic, const Now& now) const {
  RecordMarks marks;
  marks.resent = entry.outgoing.resent || entry.outgoing.old;
  if (const auto deadline = entry.outbox->options.deadline; deadline.count() > 0) {
    const auto left = entry.outgoing.accepted + deadline - now.instant;
    marks.expires_ms =
        now.wall_ms + std::max<std::int64_t>(1, std::chrono::ceil<std::chrono::milliseconds>(left).count());
  }
  return produce(client_->get(), topic, entry.outgoing.message, marks, options_.native_headers, now.wall_ms,
                 entry.envelope, &entry);
}

void PublishLink::send_waiting(Lock& lock) {
  if (!may_send()) return;
  const Instant now = clock_.now();
  // Others take from the list while a wave is handed over.
  for (std::size_t left = runnable_.size(); left > 0 && !runnable_.empty() && may_send(); --left) {
    Route& route = *runnable_.front();
    runnable_.pop_front();
    route.in_runnable = false;
    if (takes_wave(route, now)) send_wave(route, lock);
    if (!route.runnable.empty() && !std::exchange(route.in_runnable, true)) runnable_.push_back(&route);
  }
}

std::vector<PublishLink::UnderWay*> PublishLink::take_wave(Route& route, Instant now) {
  std::vector<UnderWay*> wave;
  const std::size_t most = route.answered_slowly ? most_in_slow_wave : most_in_wave;
  std::size_t bytes = 0;
  while (!route.runnable.empty() && wave.size() < most && bytes < most_bytes_in_wave) {
    const std::shared_ptr<Outbox> outbox = std::move(route.runnable.front());
    route.runnable.pop_front();
    outbox->in_runnable = false;
    outbox->expire(now);
    note(outbox);
    if (outbox->idle() || !outbox->may_send()) continue;
    const std::size_t size = outbox->next().message.payload.size();
    if (!wave.empty() && bytes + size > most_bytes_in_wave) bytes = most_bytes_in_wave;
    if (bytes < most_bytes_in_wave) {
      wave.push_back(&add_under_way(outbox, route, outbox->take_next()));
      bytes += size;
    }
    make_runnable(outbox, route);  // in turn with the others
  }
  return wave;
}

void PublishLink::send_wave(Route& route, Lock& lock) {
  const Now now{clock_.now(), clock_.wall_ms()};
  const std::vector<UnderWay*> wave = take_wave(route, now.instant);
  if (wave.empty()) return;
  const std::shared_ptr<rd_kafka_topic_t> topic = route.topic;
  route.in_wave = true;
  // Publishers go on meanwhile. Reports, which end entries, come to this thread only.
  lock.unlock();
  const Failed failed = hand_over_all(wave, topic.get(), now);
  lock.lock();
  route.in_wave = false;
  route.handed_over_at = clock_.now();
  for (const auto& [entry, error] : failed) settle(*entry, error);
}

Burst* PublishLink::burst_for(const Outbox& outbox, const Route& route) const {
  Burst* const burst = Burst::of_this_thread();
  if (burst == nullptr || route.under_way > 0) return burst;
  return watching_ && (burst->more_follow() || !outbox.idle()) ? burst : nullptr;
}

void PublishLink::send_burst() {
  const Lock lock(mutex_);
  last_burst_ = clock_.now();
  if (!may_send()) return;
  const Now now{clock_.now(), clock_.wall_ms()};
  for (std::size_t left = runnable_.size(); left > 0 && may_send(); --left) {
    Route& route = *runnable_.front();
    runnable_.pop_front();
    route.in_runnable = false;
    if (takes_wave(route, now.instant)) {
      // The lock is held, as for a single message: the client stays, and no report ends what is handed over.
      const std::vector<UnderWay*> wave = take_wave(route, now.instant);
      route.handed_over_at = now.instant;
      const std::shared_ptr<rd_kafka_topic_t> topic = route.topic;
      for (const auto& [entry, error] : hand_over_all(wave, topic.get(), now)) settle(*entry, error);
    }
    if (!route.runnable.empty() && !std::exchange(route.in_runnable, true)) runnable_.push_back(&route);
  }
  if (reporter_.due()) wake();
}

PublishLink::Failed PublishLink::hand_over_all(const std::vector<UnderWay*>& wave, rd_kafka_topic_t* topic,
                                               const Now& now) const {
  // All is ready before the library sees the first of them: its thread takes what is there when it wakes up.
  for (UnderWay* entry : wave) prepare(*entry);
  Failed failed;
  for (UnderWay* entry : wave) {
    // What came later from the same publisher must not overtake one that has to wait.
    const auto before = std::find_if(failed.begin(), failed.end(), [&](const auto& other) {
      return other.first->outbox == entry->outbox && !is_refusal(other.second);
    });
    const auto error = before != failed.end() ? before->second : hand_over(*entry, topic, now);
    if (error != RD_KAFKA_RESP_ERR_NO_ERROR) failed.emplace_back(entry, error);
  }
  return failed;
}

}  // namespace iotcloud::brokers::kafka
