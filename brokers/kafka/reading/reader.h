#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/client/wake_event.h"
#include "iotcloud/brokers/kafka/burst.h"
#include "iotcloud/brokers/kafka/reading/feed.h"
#include "iotcloud/brokers/meters.h"
#include <iotcloud/config/clock.h>

namespace iotcloud::brokers::kafka {

struct CommitOf {
  PartitionKey key;
  Committed committed;
};

/// Takes records from the partitions that the groups gave to this process, and runs the handlers: one thread for all.
/// What the groups' servers want is not its business (see Group): a handler that runs long holds up nothing there.
/// Thread safe.
class Reader : public std::enable_shared_from_this<Reader> {
 public:
  /// \param native every record has a bare body. \param on_dirty called when there is something new to commit, from any
  /// thread; must not call back.
  Reader(bool native, Meters& meters, const config::Clock& clock, std::function<void()> on_dirty);
  ~Reader() = default;
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  void start();
  /// Ends the thread. Not from a handler.
  void close();

  // For subscriptions.
  void add(const std::shared_ptr<Inlet>& inlet);
  /// Returns when its handler does not run any more, unless called from it.
  void remove(const std::shared_ptr<Inlet>& inlet);
  void pause(Inlet& inlet);
  void resume(Inlet& inlet);
  bool active(const Inlet& inlet) const;
  void settle(Feed& feed, std::uint64_t public_tag, Settlement settlement) noexcept;

  // For groups.
  /// The topics that have a reader.
  std::set<std::string> topics(const Member& member) const;
  /// The first offset of a partition that this process never handed on to the group; 0 when it never had it.
  std::int64_t handed_on(const Member& member, const PartitionKey& key) const;
  /// A partition is here: its records are handed on from now on.
  void assigned(const std::shared_ptr<Feed>& feed);
  /// Partitions leave: waits for their handlers, `limit` at most, then nothing of them is handed on or settled any
  /// more. \return what to commit
  std::vector<CommitOf> leave(Member& member, const std::set<PartitionKey>& keys, std::chrono::milliseconds limit);
  std::vector<CommitOf> take_commits(Member& member);
  /// Whether take_commits() may have something.
  bool dirty(const Member& member) const;
  void commit_failed(Member& member, const PartitionKey& key);
  /// While not connected nothing is handed on. What was handed on and not settled when the connection broke is handed
  /// on again.
  void set_connected(Member& member, bool connected);
  bool connected(const Member& member) const;
  /// There may be records in the feed's queue. From the library's threads.
  void news(std::shared_ptr<Feed> feed);

 private:
  using Lock = std::unique_lock<std::mutex>;

  void run();
  void take_news();
  bool has_room(const Feed& feed) const;
  bool has_work(const Feed& feed) const;
  void make_ready(const std::shared_ptr<Feed>& feed);
  void pull(Feed& feed);
  void take(Feed& feed, std::shared_ptr<const rd_kafka_message_t> record);
  void accept(Feed& feed, std::uint64_t tag);
  void hand_on(Lock& lock, Burst& burst);
  void run_handler(const Inlet& inlet, Arrived arrived, std::shared_ptr<Settler> settler, std::uint64_t tag);
  void give_to(Feed& feed, std::shared_ptr<Inlet> inlet);
  void mark_dirty(Feed& feed);
  void wake();

  const bool native_;
  Meters& meters_;
  const config::Clock& clock_;
  const std::function<void()> on_dirty_;
  client::WakeEvent wake_event_;

  std::mutex news_mutex_;                    ///< taken while the library holds its own: nothing is called with it held
  std::vector<std::shared_ptr<Feed>> news_;  ///< guarded by news_mutex_

  mutable std::mutex mutex_;
  std::condition_variable handler_ended_;
  // All below: guarded by mutex_.
  bool closing_ = false;
  bool sleeping_ = false;
  std::deque<std::shared_ptr<Feed>> ready_;
  std::map<std::pair<std::string, PartitionKey>, std::int64_t> handed_on_;  ///< by group; of partitions that left

  std::thread thread_;
};

}  // namespace iotcloud::brokers::kafka
