#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/read_core.h"
#include "iotcloud/brokers/client/wake_event.h"
#include "iotcloud/brokers/kafka/gathering.h"
#include "iotcloud/brokers/kafka/reading/feed.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::kafka {

using client::ReadCore;

struct CommitOf {
  PartitionKey key;
  Committed committed;
};

/// Takes records from the partitions that the groups assigned to this process, and runs the handlers, all on one
/// thread: the transport of a ReadCore. ConsumerGroup serves the group protocol on another thread, so a handler that
/// runs long does not delay it. Thread safe.
class PartitionReader final : client::ReadTransport, public std::enable_shared_from_this<PartitionReader> {
 public:
  /// \param native every record has a bare body. \param on_dirty called from any thread when there is something new to
  /// commit; must not call the reader.
  PartitionReader(bool native, Meters& meters, const config::Clock& clock, std::function<void()> on_dirty);
  ~PartitionReader() override = default;
  PartitionReader(const PartitionReader&) = delete;
  PartitionReader& operator=(const PartitionReader&) = delete;
  void start();
  /// Ends the thread. Not to be called from a handler.
  void close();

  // For subscriptions.
  void add(const std::shared_ptr<TopicSubscriber>& subscriber);
  /// Ends a subscription; returns when its handler has returned, unless called from it.
  void remove(const std::shared_ptr<TopicSubscriber>& subscriber);
  void pause(TopicSubscriber& subscriber);
  void resume(TopicSubscriber& subscriber);
  bool raise_prefetch(TopicSubscriber& subscriber, std::uint16_t prefetch);
  /// How many records its partitions have that did not arrive here, by the ends that the last fetches told; nullopt:
  /// not known.
  std::optional<std::uint64_t> backlog(const TopicSubscriber& subscriber) const;
  bool active(const TopicSubscriber& subscriber) const;
  void settle(PartitionFeed& feed, std::uint64_t public_tag, Settlement settlement) noexcept;

  // For groups.
  /// The topics that have a reader.
  std::set<std::string> topics(const GroupMember& member) const;
  /// The first offset of a partition that this process has not handed on in this group; 0 if it never had the
  /// partition.
  std::int64_t handed_on(const GroupMember& member, const PartitionKey& key) const;
  /// A partition was assigned: its records are handed on from now on.
  void assigned(const std::shared_ptr<PartitionFeed>& feed);
  /// Partitions are revoked: waits for their handlers, at most `limit`; afterwards none of their messages is handed on
  /// or settled. \return what to commit
  std::vector<CommitOf> leave(GroupMember& member, const std::set<PartitionKey>& keys, std::chrono::milliseconds limit);
  std::vector<CommitOf> take_commits(GroupMember& member);
  /// Whether take_commits() may have something.
  bool dirty(const GroupMember& member) const;
  void commit_failed(GroupMember& member, const PartitionKey& key);
  /// While not connected nothing is handed on. Messages that were unsettled when the connection broke are handed on
  /// again.
  void set_connected(GroupMember& member, bool connected);
  bool connected(const GroupMember& member) const;
  /// There may be records in the feed's queue. Called from the library's threads.
  void news(std::shared_ptr<PartitionFeed> feed);

 private:
  // The ReadTransport.
  void settled(client::DeliveryStream& stream, bool first) noexcept override IOTCLOUD_REQUIRES(core_.mutex);
  void wake() noexcept override IOTCLOUD_REQUIRES(core_.mutex);
  bool fetch(client::DeliveryStream& stream) override IOTCLOUD_REQUIRES(core_.mutex);

  void run();
  void take_news() IOTCLOUD_REQUIRES(core_.mutex);
  static bool has_room(const PartitionFeed& feed);
  void take(PartitionFeed& feed, std::shared_ptr<const rd_kafka_message_t> record) IOTCLOUD_REQUIRES(core_.mutex);
  void skip(PartitionFeed& feed, std::int64_t offset) IOTCLOUD_REQUIRES(core_.mutex);
  void hand_on(Gathering& gathering) IOTCLOUD_REQUIRES(core_.mutex);
  void give_to(PartitionFeed& feed, std::shared_ptr<TopicSubscriber> subscriber) IOTCLOUD_REQUIRES(core_.mutex);

  const bool native_;
  Meters& meters_;
  const config::Clock& clock_;
  const std::function<void()> on_dirty_;
  client::WakeEvent wake_event_;

  /// Locked while the library holds its own mutexes, so the holder calls nothing.
  config::Mutex news_mutex_;
  std::vector<std::shared_ptr<PartitionFeed>> news_ IOTCLOUD_GUARDED_BY(news_mutex_);

  ReadCore core_;
  bool closing_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  bool sleeping_ IOTCLOUD_GUARDED_BY(core_.mutex) = false;
  /// handed_on() of partitions that were revoked, by group and partition.
  std::map<std::pair<std::string, PartitionKey>, std::int64_t> handed_on_ IOTCLOUD_GUARDED_BY(core_.mutex);

  std::thread thread_;
};

}  // namespace iotcloud::brokers::kafka
