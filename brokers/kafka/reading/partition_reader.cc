#include "iotcloud/brokers/kafka/reading/partition_reader.h"

#include <algorithm>
#include <utility>

#include <pthread.h>

#include "iotcloud/brokers/kafka/record.h"
#include <iotcloud/brokers/kafka/logger.h>
#include <iotcloud/brokers/limits.h>

namespace iotcloud::brokers::kafka {
namespace {

// The most handlers in a row before the queues are checked again.
constexpr std::size_t batch = 64;
// The most records taken from one partition in a row.
constexpr std::size_t records_in_a_row = 64;
// How long messages that handlers publish are kept back, unless a single handler takes longer.
constexpr std::chrono::microseconds longest_gathering{200};
// The most deliveries remembered behind one that stays unsettled; then the partition waits for that one.
constexpr std::size_t longest_window = 65536;

/// The first subscription to a topic reads it.
std::shared_ptr<TopicSubscriber> reader_of(const GroupMember& member, const std::string& topic) {
  const auto found = std::find_if(member.subscribers.begin(), member.subscribers.end(),
                                  [&](const auto& subscriber) { return subscriber->topic.name == topic; });
  return found == member.subscribers.end() ? nullptr : *found;
}

void on_news(rd_kafka_t*, void* opaque) {
  auto& feed = *static_cast<PartitionFeed*>(opaque);
  feed.reader->news(std::static_pointer_cast<PartitionFeed>(feed.shared_from_this()));
}

}  // namespace

PartitionFeed::PartitionFeed(std::shared_ptr<PartitionReader> to, std::shared_ptr<GroupMember> of,
                             std::shared_ptr<KafkaClient> from, PartitionKey what, Progress how_far)
    : FeedProgress{std::move(how_far)},
      DeliveryStream(nullptr, progress.window()),
      reader(std::move(to)),
      member(std::move(of)),
      key(std::move(what)),
      client(std::move(from)),
      queue(rd_kafka_queue_get_partition(client->get(), key.first.c_str(), key.second)) {}

void PartitionFeed::settle(std::uint64_t tag, Settlement settlement) noexcept {
  reader->settle(*this, tag, settlement);
}

PartitionReader::PartitionReader(bool native, Meters& meters, const config::Clock& clock,
                                 std::function<void()> on_dirty)
    : native_(native),
      meters_(meters),
      clock_(clock),
      on_dirty_(std::move(on_dirty)),
      core_(*this, meters, clock, std::chrono::milliseconds(0)) {}

void PartitionReader::start() {
  thread_ = std::thread([this] { run(); });
  pthread_setname_np(thread_.native_handle(), "kafka-consume");
}

void PartitionReader::close() {
  {
    const config::MutexLock lock(core_.mutex);
    closing_ = true;
    core_.stop();
  }
  wake_event_.signal();
  if (thread_.joinable()) thread_.join();
  // Feeds own their reader, so the reader must drop its references to them, or neither would be destroyed.
  const config::MutexLock lock(core_.mutex);
  core_.connection_lost();
  const config::MutexLock news_lock(news_mutex_);
  news_.clear();
}

void PartitionReader::news(std::shared_ptr<PartitionFeed> feed) {
  {
    const config::MutexLock lock(news_mutex_);
    news_.push_back(std::move(feed));
    if (news_.size() > 1) return;  // the thread has been signalled and has not looked yet
  }
  wake_event_.signal();
}

void PartitionReader::wake() noexcept {
  if (std::exchange(sleeping_, false)) wake_event_.signal();
}

bool PartitionReader::has_room(const PartitionFeed& feed) {
  if (feed.window.size() >= longest_window) return false;
  const TopicSubscriber& subscriber = *feed.reads_it();
  const std::size_t prefetch = std::max<std::size_t>(subscriber.prefetch, 1);
  // With keep_last, waiting messages must not use up the room for newer ones.
  const std::size_t newest = subscriber.options.keep_last > 0 ? feed.window.waiting() : 0;
  return subscriber.unsettled - newest < prefetch;
}

void PartitionReader::settle(PartitionFeed& feed, std::uint64_t public_tag, Settlement settlement) noexcept {
  const config::MutexLock lock(core_.mutex);
  core_.settle(feed, public_tag, settlement);
}

void PartitionReader::settled(client::DeliveryStream& stream, bool first) noexcept {
  auto& feed = static_cast<PartitionFeed&>(stream);
  --feed.reads_it()->unsettled;
  if (first) on_dirty_();
  // Other partitions of the subscription may wait for the same room.
  for (const auto& [key, other] : feed.member->feeds) {
    if (other->subscriber == feed.subscriber) core_.make_ready(*other);
  }
  if (core_.has_ready()) wake();
}

void PartitionReader::run() {
  Gathering gathering;  // for all messages that the handlers publish until nothing is left to hand on
  const config::MutexLock lock(core_.mutex);
  while (!closing_) {
    take_news();
    hand_on(gathering);
    if (!gathering.empty()) {
      const config::Unlocked unlocked(core_.mutex);
      gathering.end();
    }
    if (core_.has_ready() || closing_) continue;
    sleeping_ = true;
    {
      const config::Unlocked unlocked(core_.mutex);
      wake_event_.wait(-1, false, std::chrono::minutes(1));
    }
    sleeping_ = false;
  }
}

void PartitionReader::take_news() {
  std::vector<std::shared_ptr<PartitionFeed>> news;
  {
    const config::MutexLock lock(news_mutex_);
    news.swap(news_);
  }
  for (const auto& feed : news) {
    feed->more = true;
    core_.make_ready(*feed);
  }
}

bool PartitionReader::fetch(client::DeliveryStream& stream) {
  auto& feed = static_cast<PartitionFeed&>(stream);
  for (std::size_t i = 0; i < records_in_a_row && has_room(feed); ++i) {
    rd_kafka_message_t* record = rd_kafka_consume_queue(feed.queue.get(), 0);
    if (record == nullptr) {
      feed.more = false;
      return false;
    }
    // The record must be destroyed before its client.
    take(feed, std::shared_ptr<const rd_kafka_message_t>(
                   record, [client = feed.client](rd_kafka_message_t* done) { rd_kafka_message_destroy(done); }));
  }
  return has_room(feed);
}

void PartitionReader::take(PartitionFeed& feed, std::shared_ptr<const rd_kafka_message_t> record) {
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
          "topic {}, partition {}: the record at offset {} is no TSensorMessage, or has more than {} headers; skipping "
          "it "
          "and others like it (property envelope: headers reads records with a bare body)",
          feed.key.first, feed.key.second, offset, max_received_properties);
    }
    return skip(feed, offset);
  }
  feed.complained = false;
  if (read->marks.expires_ms != 0 && read->marks.expires_ms <= clock_.wall_ms()) {
    meters_.skipped(reason::deadline);
    return skip(feed, offset);
  }
  std::int64_t oldest = 0;
  std::int64_t end = offset + 1;
  if (feed.progress.wants_log_end()) {
    rd_kafka_get_watermark_offsets(feed.client->get(), feed.key.first.c_str(), feed.key.second, &oldest, &end);
  }
  const bool again = feed.progress.maybe_handed_on(offset, end) || read->marks.resent;
  feed.progress.arrived(offset, std::move(read->message), again);
  ++feed.reads_it()->unsettled;
  core_.conflate(feed);
}

void PartitionReader::skip(PartitionFeed& feed, std::int64_t offset) {
  feed.progress.skipped(offset);
  if (core_.make_dirty(feed)) on_dirty_();
}

void PartitionReader::hand_on(Gathering& gathering) {
  ReadCore::Turn turn(core_);
  for (std::size_t i = 0; i < batch; ++i) {
    const client::DeliveryStream* const feed = core_.take(turn);
    if (feed == nullptr) return;
    gathering.more_follow(feed->window.waiting() > 0);
    core_.run(turn);
    if (gathering.empty() || clock_.now() - gathering.began() <= longest_gathering) continue;
    const config::Unlocked unlocked(core_.mutex);
    gathering.end();
  }
}

void PartitionReader::give_to(PartitionFeed& feed, std::shared_ptr<TopicSubscriber> subscriber) {
  if (feed.subscriber == subscriber) return;
  if (feed.subscriber) feed.reads_it()->unsettled -= feed.progress.unsettled();
  feed.take_back();
  feed.subscriber = std::move(subscriber);
  if (feed.subscriber) feed.reads_it()->unsettled += feed.progress.unsettled();
  core_.make_ready(feed);
}

void PartitionReader::add(const std::shared_ptr<TopicSubscriber>& subscriber) {
  const config::MutexLock lock(core_.mutex);
  GroupMember& member = *subscriber->member;
  member.subscribers.push_back(subscriber);
  for (const auto& [key, feed] : member.feeds) {
    if (key.first == subscriber->topic.name && !feed->subscriber) give_to(*feed, subscriber);
  }
  wake();
}

void PartitionReader::remove(const std::shared_ptr<TopicSubscriber>& subscriber) {
  const config::MutexLock lock(core_.mutex);
  GroupMember& member = *subscriber->member;
  core_.end(*subscriber);
  std::erase(member.subscribers, subscriber);
  for (const auto& [key, feed] : member.feeds) {
    if (feed->subscriber == subscriber) give_to(*feed, reader_of(member, key.first));
  }
  wake();
  core_.await_handler(*subscriber);
}

void PartitionReader::pause(TopicSubscriber& subscriber) {
  const config::MutexLock lock(core_.mutex);
  core_.pause(subscriber);
}

bool PartitionReader::raise_prefetch(TopicSubscriber& subscriber, std::uint16_t prefetch) {
  if (prefetch > subscriber.options.prefetch_limit) return false;
  const config::MutexLock lock(core_.mutex);
  subscriber.prefetch = std::max(subscriber.prefetch, prefetch);
  for (const auto& [key, feed] : subscriber.member->feeds) {
    if (feed->subscriber.get() == &subscriber) core_.make_ready(*feed);
  }
  if (core_.has_ready()) wake();
  return true;
}

void PartitionReader::resume(TopicSubscriber& subscriber) {
  const config::MutexLock lock(core_.mutex);
  subscriber.paused = false;
  for (const auto& [key, feed] : subscriber.member->feeds) {
    if (feed->subscriber.get() == &subscriber) core_.resume(*feed);
  }
}

bool PartitionReader::active(const TopicSubscriber& subscriber) const {
  const config::MutexLock lock(core_.mutex);
  const auto& feeds = subscriber.member->feeds;
  return subscriber.member->connected && !subscriber.closed &&
         std::any_of(feeds.begin(), feeds.end(), [&](const auto& entry) {
           return entry.second->subscriber.get() == &subscriber && !entry.second->leaving;
         });
}

std::optional<std::uint64_t> PartitionReader::backlog(const TopicSubscriber& subscriber) const {
  const config::MutexLock lock(core_.mutex);
  std::optional<std::uint64_t> sum;
  for (const auto& [key, feed] : subscriber.member->feeds) {
    if (feed->subscriber.get() != &subscriber || feed->withheld || !feed->progress.placed()) continue;
    std::int64_t oldest = 0;
    std::int64_t end = 0;
    // What the library remembers of its last fetch: no request, and no wait.
    const auto failed =
        rd_kafka_get_watermark_offsets(feed->client->get(), key.first.c_str(), key.second, &oldest, &end);
    if (failed != RD_KAFKA_RESP_ERR_NO_ERROR || end < 0) continue;
    const std::int64_t next = std::max(feed->progress.expects(), oldest);
    sum = sum.value_or(0) + static_cast<std::uint64_t>(std::max<std::int64_t>(end - next, 0));
  }
  return sum;
}

std::set<std::string> PartitionReader::topics(const GroupMember& member) const {
  const config::MutexLock lock(core_.mutex);
  std::set<std::string> names;
  for (const auto& subscriber : member.subscribers) names.insert(subscriber->topic.name);
  return names;
}

std::int64_t PartitionReader::handed_on(const GroupMember& member, const PartitionKey& key) const {
  const config::MutexLock lock(core_.mutex);
  const auto found = handed_on_.find({member.name, key});
  return found == handed_on_.end() ? 0 : found->second;
}

void PartitionReader::assigned(const std::shared_ptr<PartitionFeed>& feed) {
  const config::MutexLock lock(core_.mutex);
  GroupMember& member = *feed->member;
  member.feeds[feed->key] = feed;
  feed->withheld = !member.connected;
  // Do not forward records to the group's queue, where they would wait for the groups' thread.
  rd_kafka_queue_forward(feed->queue.get(), nullptr);
  rd_kafka_queue_cb_event_enable(feed->queue.get(), on_news, feed.get());
  feed->more = true;  // the library does not signal a queue that is already non-empty
  give_to(*feed, reader_of(member, feed->key.first));
  wake();
  core_.make_dirty(*feed);
  on_dirty_();
}

std::vector<CommitOf> PartitionReader::leave(GroupMember& member, const std::set<PartitionKey>& keys,
                                             std::chrono::milliseconds limit) {
  const config::MutexLock lock(core_.mutex);
  std::vector<std::shared_ptr<client::DeliveryStream>> leaving;
  for (const auto& [key, feed] : member.feeds) {
    if (!keys.contains(key)) continue;
    feed->leaving = feed->withheld = true;
    leaving.push_back(feed);
  }
  core_.await_handlers(leaving, clock_.now() + limit);
  std::vector<CommitOf> commits;
  for (const auto& stream : leaving) {
    auto& feed = static_cast<PartitionFeed&>(*stream);
    give_to(feed, nullptr);
    core_.forget(feed);
    handed_on_[{member.name, feed.key}] = feed.progress.handed_on();
    if (auto commit = feed.progress.to_commit(true)) commits.push_back({feed.key, std::move(*commit)});
    rd_kafka_queue_cb_event_enable(feed.queue.get(), nullptr, nullptr);
    feed.queue.reset();
    feed.client.reset();
    member.feeds.erase(feed.key);
  }
  return commits;
}

std::vector<CommitOf> PartitionReader::take_commits(GroupMember& member) {
  const config::MutexLock lock(core_.mutex);
  std::vector<CommitOf> commits;
  for (const auto& [key, feed] : member.feeds) {
    if (!feed->in_dirty) continue;
    core_.take_dirty(*feed);
    if (auto commit = feed->progress.to_commit(false)) commits.push_back({key, std::move(*commit)});
    core_.make_ready(*feed);  // the window may have room again
  }
  if (core_.has_ready()) wake();
  return commits;
}

bool PartitionReader::dirty(const GroupMember& member) const {
  const config::MutexLock lock(core_.mutex);
  return std::any_of(member.feeds.begin(), member.feeds.end(),
                     [](const auto& entry) { return entry.second->in_dirty; });
}

bool PartitionReader::connected(const GroupMember& member) const {
  const config::MutexLock lock(core_.mutex);
  return member.connected;
}

void PartitionReader::commit_failed(GroupMember& member, const PartitionKey& key) {
  const config::MutexLock lock(core_.mutex);
  const auto found = member.feeds.find(key);
  if (found == member.feeds.end()) return;
  found->second->progress.commit_failed();
  core_.make_dirty(*found->second);
}

void PartitionReader::set_connected(GroupMember& member, bool connected) {
  const config::MutexLock lock(core_.mutex);
  if (std::exchange(member.connected, connected) == connected) return;
  for (const auto& [key, feed] : member.feeds) {
    feed->withheld = !connected || feed->leaving;
    if (!connected) feed->take_back();
    core_.make_ready(*feed);
  }
  wake();
}

}  // namespace iotcloud::brokers::kafka
