#include "iotcloud/brokers/kafka/reading/reader.h"

#include <algorithm>
#include <exception>
#include <utility>

#include <pthread.h>

#include "iotcloud/brokers/kafka/record.h"
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::kafka {
namespace {

const config::Logger logger{"brokers.kafka"};

// After so many handlers the queues are looked at again.
constexpr std::size_t batch = 64;
// Records taken from one partition in a row.
constexpr std::size_t records_in_a_row = 64;
// What handlers publish is kept back no longer, but for one handler that takes longer itself.
constexpr std::chrono::microseconds longest_burst{200};
// Behind one that is not settled for ever: so many are remembered, then the partition waits for it.
constexpr std::size_t longest_window = 65536;

}  // namespace

Feed::Feed(std::shared_ptr<Reader> to, std::shared_ptr<Member> of, std::shared_ptr<Client> from, PartitionKey what,
           Progress how_far)
    : reader(std::move(to)),
      member(std::move(of)),
      key(std::move(what)),
      client(std::move(from)),
      queue(rd_kafka_queue_get_partition(client->get(), key.first.c_str(), key.second)),
      progress(std::move(how_far)) {}

void Feed::settle(std::uint64_t tag, Settlement settlement) noexcept {
  reader->settle(*this, tag, settlement);
}

Reader::Reader(bool native, Meters& meters, const config::Clock& clock, std::function<void()> on_dirty)
    : native_(native), meters_(meters), clock_(clock), on_dirty_(std::move(on_dirty)) {}

void Reader::start() {
  thread_ = std::thread([this] { run(); });
  pthread_setname_np(thread_.native_handle(), "kafka-consume");
}

void Reader::close() {
  {
    const Lock lock(mutex_);
    closing_ = true;
  }
  wake_event_.signal();
  if (thread_.joinable()) thread_.join();
  // Feeds hold their reader: what is left of them here must not hold it in a circle.
  const Lock lock(mutex_);
  ready_.clear();
  const std::lock_guard news_lock(news_mutex_);
  news_.clear();
}

void Reader::news(std::shared_ptr<Feed> feed) {
  {
    const std::lock_guard lock(news_mutex_);
    news_.push_back(std::move(feed));
    if (news_.size() > 1) return;  // the thread was signalled and did not look yet
  }
  wake_event_.signal();
}

void Reader::wake() {
  if (std::exchange(sleeping_, false)) wake_event_.signal();
}

void Reader::mark_dirty(Feed& feed) {
  if (!std::exchange(feed.dirty, true)) on_dirty_();
}

bool Reader::has_room(const Feed& feed) const {
  if (feed.progress.size() >= longest_window) return false;
  const std::size_t prefetch = std::max<std::size_t>(feed.inlet->options.prefetch, 1);
  // What waits never stands in the way of what is newer when only the newest count.
  const std::size_t newest = feed.inlet->options.keep_last > 0 ? feed.progress.waiting() : 0;
  return feed.inlet->unsettled - newest < prefetch;
}

bool Reader::has_work(const Feed& feed) const {
  if (feed.closed || feed.leaving || !feed.inlet || feed.inlet->closed || !feed.member->connected) return false;
  return (feed.progress.waiting() > 0 && !feed.inlet->paused) || (feed.may_have_more && has_room(feed));
}

void Reader::make_ready(const std::shared_ptr<Feed>& feed) {
  if (feed->in_ready || !has_work(*feed)) return;
  feed->in_ready = true;
  ready_.push_back(feed);
}

void Reader::settle(Feed& feed, std::uint64_t public_tag, Settlement settlement) noexcept {
  const Lock lock(mutex_);
  constexpr std::uint64_t tag_mask = (std::uint64_t{1} << 48U) - 1;
  const std::uint64_t tag = public_tag & tag_mask;
  if (feed.closed || public_tag != feed.public_tag(tag) || !feed.progress.settle(tag, settlement)) return;
  if (settlement != Settlement::retry) {
    if (feed.inlet) --feed.inlet->unsettled;
    mark_dirty(feed);
  }
  if (!feed.inlet) return;
  // Other partitions of the subscription may have waited for room too.
  for (const auto& [key, other] : feed.member->feeds) {
    if (other->inlet == feed.inlet) make_ready(other);
  }
  if (!ready_.empty()) wake();
}

void Reader::accept(Feed& feed, std::uint64_t tag) {
  if (!feed.progress.settle(tag, Settlement::accept)) return;
  --feed.inlet->unsettled;
  mark_dirty(feed);
}

void Reader::run() {
  Burst burst;  // of all that the handlers publish, before there is nothing to hand on for now
  Lock lock(mutex_);
  while (!closing_) {
    take_news();
    hand_on(lock, burst);
    if (!burst.empty()) {
      lock.unlock();
      burst.end();
      lock.lock();
    }
    if (!ready_.empty() || closing_) continue;
    sleeping_ = true;
    lock.unlock();
    wake_event_.wait(-1, false, std::chrono::minutes(1));
    lock.lock();
    sleeping_ = false;
  }
}

void Reader::take_news() {
  std::vector<std::shared_ptr<Feed>> news;
  {
    const std::lock_guard lock(news_mutex_);
    news.swap(news_);
  }
  for (const auto& feed : news) {
    feed->may_have_more = true;
    make_ready(feed);
  }
}

void Reader::pull(Feed& feed) {
  for (std::size_t i = 0; i < records_in_a_row && feed.may_have_more && has_room(feed); ++i) {
    rd_kafka_message_t* record = rd_kafka_consume_queue(feed.queue.get(), 0);
    if (record == nullptr) {
      feed.may_have_more = false;
      return;
    }
    // The record must end before its client does.
    take(feed, std::shared_ptr<const rd_kafka_message_t>(
                   record, [client = feed.client](rd_kafka_message_t* done) { rd_kafka_message_destroy(done); }));
  }
}

void Reader::take(Feed& feed, std::shared_ptr<const rd_kafka_message_t> record) {
  if (record->err != RD_KAFKA_RESP_ERR_NO_ERROR) {
    logger.warn("topic {}, partition {}: {}", feed.key.first, feed.key.second, rd_kafka_message_errstr(record.get()));
    return;
  }
  const std::int64_t offset = record->offset;
  if (feed.progress.was_settled(offset)) {
    feed.progress.skipped(offset);
    return;
  }
  std::optional<ReadRecord> read = read_record(std::move(record), native_);
  if (!read) {
    meters_.skipped(reason::undecodable);
    if (!std::exchange(feed.complained, true)) {
      logger.error(
          "topic {}, partition {}: the record at offset {} is no TSensorMessage; skipping it and others like it "
          "(property envelope: headers reads records with a bare body)",
          feed.key.first, feed.key.second, offset);
    }
    feed.progress.skipped(offset);
    mark_dirty(feed);
    return;
  }
  feed.complained = false;
  if (read->marks.expires_ms != 0 && read->marks.expires_ms <= clock_.wall_ms()) {
    meters_.skipped(reason::deadline);
    feed.progress.skipped(offset);
    mark_dirty(feed);
    return;
  }
  std::int64_t oldest = 0;
  std::int64_t end = offset + 1;
  if (feed.progress.wants_log_end()) {
    rd_kafka_get_watermark_offsets(feed.client->get(), feed.key.first.c_str(), feed.key.second, &oldest, &end);
  }
  const bool again = feed.progress.maybe_handed_on(offset, end) || read->marks.resent;
  feed.progress.arrived(offset, std::move(read->message), again);
  Inlet& inlet = *feed.inlet;
  ++inlet.unsettled;
  while (inlet.options.keep_last > 0 && feed.progress.waiting() > inlet.options.keep_last) {
    accept(feed, feed.progress.next().tag);
    meters_.conflated();
  }
}

void Reader::hand_on(Lock& lock, Burst& burst) {
  for (std::size_t i = 0; i < batch && !ready_.empty() && !closing_; ++i) {
    const std::shared_ptr<Feed> feed = std::move(ready_.front());
    ready_.pop_front();
    feed->in_ready = false;
    if (!has_work(*feed)) continue;
    const std::shared_ptr<Inlet> inlet = feed->inlet;
    pull(*feed);
    if (feed->progress.waiting() == 0 || inlet->paused) {
      make_ready(feed);
      continue;
    }
    Arrived arrived = feed->progress.next();
    meters_.received(arrived.redelivered);
    std::shared_ptr<Settler> settler = feed;
    if (inlet->options.automatic_ack) {
      settler = nullptr;
      accept(*feed, arrived.tag);
    }
    make_ready(feed);  // in turn with the others
    const std::uint64_t tag = feed->public_tag(arrived.tag);
    inlet->running = feed->running = true;
    burst.more_follow(feed->progress.waiting() > 0);
    lock.unlock();
    run_handler(*inlet, std::move(arrived), std::move(settler), tag);
    if (!burst.empty() && clock_.now() - burst.began() > longest_burst) burst.end();
    lock.lock();
    inlet->running = feed->running = false;
    handler_ended_.notify_all();
  }
}

void Reader::run_handler(const Inlet& inlet, Arrived arrived, std::shared_ptr<Settler> settler, std::uint64_t tag) {
  try {
    Delivery delivery(std::move(arrived.message), arrived.redelivered, std::move(settler), tag);
    delivery.tries = arrived.tries;
    inlet.handler(std::move(delivery));
  } catch (const std::exception& error) {
    logger.error("the handler of topic {} threw: {}; the message is delivered again", inlet.topic.name, error.what());
  } catch (...) {
    logger.error("the handler of topic {} threw; the message is delivered again", inlet.topic.name);
  }
}

}  // namespace iotcloud::brokers::kafka
