// Who reads what: subscriptions that come and go, partitions that the groups give and take.
#include <algorithm>
#include <utility>

#include "iotcloud/brokers/kafka/reading/reader.h"

namespace iotcloud::brokers::kafka {
namespace {

/// The first subscription to a topic reads it.
std::shared_ptr<Inlet> reader_of(const Member& member, const std::string& topic) {
  const auto found = std::find_if(member.inlets.begin(), member.inlets.end(),
                                  [&](const auto& inlet) { return inlet->topic.name == topic; });
  return found == member.inlets.end() ? nullptr : *found;
}

void on_news(rd_kafka_t*, void* opaque) {
  auto& feed = *static_cast<Feed*>(opaque);
  feed.reader->news(feed.shared_from_this());
}

}  // namespace

void Reader::give_to(Feed& feed, std::shared_ptr<Inlet> inlet) {
  if (feed.inlet == inlet) return;
  if (feed.inlet) feed.inlet->unsettled -= feed.progress.unsettled();
  ++feed.generation;
  feed.progress.return_all();
  feed.inlet = std::move(inlet);
  if (feed.inlet) feed.inlet->unsettled += feed.progress.unsettled();
}

void Reader::add(const std::shared_ptr<Inlet>& inlet) {
  const Lock lock(mutex_);
  Member& member = *inlet->member;
  member.inlets.push_back(inlet);
  for (const auto& [key, feed] : member.feeds) {
    if (key.first != inlet->topic.name || feed->inlet) continue;
    give_to(*feed, inlet);
    make_ready(feed);
  }
  wake();
}

void Reader::remove(const std::shared_ptr<Inlet>& inlet) {
  Lock lock(mutex_);
  Member& member = *inlet->member;
  inlet->closed = true;
  std::erase(member.inlets, inlet);
  for (const auto& [key, feed] : member.feeds) {
    if (feed->inlet != inlet) continue;
    give_to(*feed, reader_of(member, key.first));
    make_ready(feed);
  }
  wake();
  if (std::this_thread::get_id() == thread_.get_id()) return;
  handler_ended_.wait(lock, [&] { return !inlet->running; });
}

void Reader::pause(Inlet& inlet) {
  const Lock lock(mutex_);
  inlet.paused = true;
}

void Reader::resume(Inlet& inlet) {
  const Lock lock(mutex_);
  inlet.paused = false;
  for (const auto& [key, feed] : inlet.member->feeds) {
    if (feed->inlet.get() == &inlet) make_ready(feed);
  }
  wake();
}

bool Reader::active(const Inlet& inlet) const {
  const Lock lock(mutex_);
  const auto& feeds = inlet.member->feeds;
  return inlet.member->connected && !inlet.closed && std::any_of(feeds.begin(), feeds.end(), [&](const auto& entry) {
           return entry.second->inlet.get() == &inlet && !entry.second->leaving;
         });
}

std::set<std::string> Reader::topics(const Member& member) const {
  const Lock lock(mutex_);
  std::set<std::string> names;
  for (const auto& inlet : member.inlets) names.insert(inlet->topic.name);
  return names;
}

std::int64_t Reader::handed_on(const Member& member, const PartitionKey& key) const {
  const Lock lock(mutex_);
  const auto found = handed_on_.find({member.name, key});
  return found == handed_on_.end() ? 0 : found->second;
}

void Reader::assigned(const std::shared_ptr<Feed>& feed) {
  const Lock lock(mutex_);
  Member& member = *feed->member;
  member.feeds[feed->key] = feed;
  give_to(*feed, reader_of(member, feed->key.first));
  // Not to the group's own queue, where it would wait for the group's thread.
  rd_kafka_queue_forward(feed->queue.get(), nullptr);
  rd_kafka_queue_cb_event_enable(feed->queue.get(), on_news, feed.get());
  feed->may_have_more = true;  // something from before would keep the library from calling
  make_ready(feed);
  wake();
  on_dirty_();
}

std::vector<CommitOf> Reader::leave(Member& member, const std::set<PartitionKey>& keys,
                                    std::chrono::milliseconds limit) {
  Lock lock(mutex_);
  std::vector<std::shared_ptr<Feed>> leaving;
  for (const auto& [key, feed] : member.feeds) {
    if (keys.contains(key)) leaving.push_back(feed);
  }
  for (const auto& feed : leaving) feed->leaving = true;
  handler_ended_.wait_until(lock, std::chrono::system_clock::now() + limit, [&] {
    return std::none_of(leaving.begin(), leaving.end(), [](const auto& feed) { return feed->running; });
  });
  std::vector<CommitOf> commits;
  for (const auto& feed : leaving) {
    give_to(*feed, nullptr);
    feed->closed = true;
    handed_on_[{member.name, feed->key}] = feed->progress.handed_on();
    if (auto commit = feed->progress.to_commit(true)) commits.push_back({feed->key, std::move(*commit)});
    rd_kafka_queue_cb_event_enable(feed->queue.get(), nullptr, nullptr);
    feed->queue.reset();
    feed->client.reset();
    member.feeds.erase(feed->key);
  }
  return commits;
}

std::vector<CommitOf> Reader::take_commits(Member& member) {
  const Lock lock(mutex_);
  std::vector<CommitOf> commits;
  for (const auto& [key, feed] : member.feeds) {
    if (!std::exchange(feed->dirty, false)) continue;
    if (auto commit = feed->progress.to_commit(false)) commits.push_back({key, std::move(*commit)});
  }
  return commits;
}

bool Reader::dirty(const Member& member) const {
  const Lock lock(mutex_);
  return std::any_of(member.feeds.begin(), member.feeds.end(), [](const auto& entry) { return entry.second->dirty; });
}

bool Reader::connected(const Member& member) const {
  const Lock lock(mutex_);
  return member.connected;
}

void Reader::commit_failed(Member& member, const PartitionKey& key) {
  const Lock lock(mutex_);
  const auto found = member.feeds.find(key);
  if (found == member.feeds.end()) return;
  found->second->progress.commit_failed();
  found->second->dirty = true;
}

void Reader::set_connected(Member& member, bool connected) {
  const Lock lock(mutex_);
  if (std::exchange(member.connected, connected) == connected) return;
  for (const auto& [key, feed] : member.feeds) {
    if (!connected) {
      ++feed->generation;
      feed->progress.return_all();
    } else {
      make_ready(feed);
    }
  }
  wake();
}

}  // namespace iotcloud::brokers::kafka
