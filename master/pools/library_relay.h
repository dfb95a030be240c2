#pragma once

#include <chrono>
#include <map>
#include <set>
#include <stop_token>
#include <string>
#include <thread>
#include <utility>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/master/gateways/pool_client.h>

namespace iotcloud::master {

class Master;

/// Sends the component libraries of submitted topologies from pools that have them to pools that have not, such as
/// those that start later: a pool gets no worker of a topology whose libraries it lacks. Works while this master leads,
/// on a thread of its own.
class LibraryRelay {
 public:
  struct Options {
    discovery::Paths paths;
    PoolAccess access;
    PassLimits limits{};
    std::chrono::milliseconds retry_pause{5'000};  ///< after a library could not be passed on
  };
  /// \param master, registry outlive this
  LibraryRelay(const Master& master, discovery::Registry& registry, Options options);
  ~LibraryRelay();

 private:
  void run(const std::stop_token& stop);
  void pass_all(const std::stop_token& stop);
  using Errand = std::pair<discovery::PoolId, std::string>;  ///< the pool that lacks a library, and its SHA-256
  bool pass(const discovery::PoolRecord& taker, const discovery::SentLibrary& library,
            const std::vector<discovery::PoolRecord>& pools, const std::stop_token& stop);
  void forget_others(const std::vector<discovery::PoolRecord>& pools);
  void on_pools(const std::optional<std::vector<std::string>>& names);
  void look();

  const Master& master_;
  discovery::Registry& registry_;
  const Options options_;
  // Used on thread_ only.
  std::map<Errand, config::Clock::Instant> failed_;  ///< when it is tried again
  /// Pools that held the thread up, and when they get another library: each leaves as much time to others.
  std::map<discovery::PoolId, config::Clock::Instant> slow_;
  /// Pools from which a library did not come, and when that was: others are asked before them.
  std::map<discovery::PoolId, config::Clock::Instant> unwilling_;

  config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  bool due_ IOTCLOUD_GUARDED_BY(mutex_) = true;
  std::jthread thread_;
  std::map<std::string, discovery::GuardPtr> pools_;  ///< used on the registry's dispatcher, until names_ is gone
  discovery::GuardPtr names_;
};

}  // namespace iotcloud::master
