#pragma once

#include <chrono>
#include <memory>
#include <stop_token>
#include <string>
#include <thread>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/submissions.h>

namespace iotcloud::topology {

/// A pool's place in the registry: an ephemeral node that shows others that the pool lives, and what it does. Only one
/// pool with a given id can have it. Thread safe.
class PoolPresence {
 public:
  /// \param registry outlives this. \param record its `state_id` tells a node that a dead run of this pool left from
  /// another pool's.
  PoolPresence(discovery::Registry& registry, discovery::Paths paths, discovery::PoolRecord record);
  /// Leaves.
  ~PoolPresence();

  /// Takes the place; without the registry, as soon as that answers. \param patience how long another pool's node may
  /// stand: until a dead one's session must have expired. \throws config::Error when another pool has this id
  void join(std::chrono::milliseconds patience, const std::stop_token& stop);
  /// Shows what the pool does from now on. Returns at once.
  void show(std::vector<discovery::PlaceStatus> places, std::vector<std::string> files, std::string trouble);
  /// Why the registry does not show this pool; empty: it does, or is away.
  std::string trouble() const;
  void leave();

 private:
  bool take();
  void run(const std::stop_token& stop);
  void report();

  discovery::Registry& registry_;
  const std::string path_;
  mutable config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  discovery::PoolRecord record_ IOTCLOUD_GUARDED_BY(mutex_);
  bool due_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  bool joined_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  discovery::GuardPtr node_, sessions_;
  std::jthread thread_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::topology
