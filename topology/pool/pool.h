#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/daemon/daemon.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/processes/plugin_store.h>
#include <iotcloud/processes/restarts.h>
#include <iotcloud/security/trusted_keys.h>
#include <iotcloud/topology/pool/pool_presence.h>
#include <iotcloud/topology/pool/pool_watch.h>
#include <iotcloud/topology/pool/worker_fleet.h>

namespace iotcloud::topology {

/// A pool's settings, and the objects that it uses.
struct PoolOptions {
  discovery::PoolRecord record;             ///< id, state_id, address of the Thrift service, most_workers
  discovery::Registry* registry = nullptr;  ///< not null; outlives the pool
  discovery::Paths paths;
  std::shared_ptr<WorkerLauncher> launcher;              ///< not null
  std::shared_ptr<processes::PluginStore> libraries;     ///< component libraries that were sent; not null
  std::shared_ptr<const security::TrustedKeys> masters;  ///< null: submissions need no signature
  std::chrono::milliseconds session_timeout{10000};      ///< of the registry
  std::chrono::milliseconds stop_limit{10000};           ///< how long a worker may drain
  processes::RestartPolicy restart;
};

/// Runs its share of the topologies that are submitted (discovery/submissions.h): holds worker places in the registry
/// and keeps a worker running for each. Pools come to their shares by themselves (place_shares.h), without a master:
/// what a lost pool held is taken over as soon as its session has expired. While the registry is away nothing moves,
/// and workers go on. Thread safe.
class Pool final : public config::DaemonService {
 public:
  explicit Pool(PoolOptions options);
  /// Calls stop() with a limit of five seconds unless it was called.
  ~Pool() override;

  /// Adopts running workers and joins the other pools. \throws config::Error if another pool with this id lives; its
  /// own workers go on.
  void start(const std::stop_token& stop) override;
  using config::DaemonService::start;
  /// Leaves the registry, so that other pools take over, and drains and ends all workers.
  void stop(std::chrono::milliseconds limit) override;
  std::string trouble() const override;
  /// A component library was sent.
  void take_library();

  std::vector<discovery::PlaceStatus> places() const;

 private:
  /// A place that this pool holds or asks for.
  struct Claim {
    discovery::GuardPtr node;
    bool held = false;
  };

  void post(std::function<void()> task);
  void run(const std::stop_token& stop);
  void look(PoolView view, std::string trouble);
  void follow();
  void follow(const discovery::PlaceId& place, const discovery::PoolId* whose);
  bool is_this(const discovery::PoolRecord& pool) const;
  void claim(const discovery::PlaceId& place);
  bool remove_former(const discovery::PlaceId& place);
  void let_go(const std::map<discovery::PlaceId, discovery::PoolId>& shared);
  std::string holder() const;
  void attempt(const std::function<void()>& task);
  void leave();
  void show();
  void clean_libraries();

  const PoolOptions options_;
  PoolPresence presence_;

  mutable config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  std::vector<std::function<void()>> tasks_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<discovery::PlaceStatus> shown_ IOTCLOUD_GUARDED_BY(mutex_);
  std::string refused_ IOTCLOUD_GUARDED_BY(mutex_);  ///< which submissions are refused, and why
  bool gone_ IOTCLOUD_GUARDED_BY(mutex_) = false;    ///< while it stops: no worker is left

  // Used on thread_ only, once it runs.
  std::optional<PoolView> view_;  ///< nullopt: the registry has not answered yet
  std::map<discovery::PlaceId, Claim> claims_;
  bool leaving_ = false;
  bool to_show_ = false;
  WorkerFleet fleet_;

  bool stopped_ = false;
  std::unique_ptr<PoolWatch> watch_;
  std::jthread thread_;  ///< last, because it uses the other members
};

}  // namespace iotcloud::topology
