#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/processes/restarts.h>
#include <iotcloud/topology/pool/worker_launcher.h>

namespace iotcloud::topology {

/// The workers of one pool: starts one for each place that it is told to run, replaces it when the place is to run
/// another version, and starts it again, after a pause that doubles, when it fails. Used on one thread.
class WorkerFleet {
 public:
  struct Options {
    processes::RestartPolicy restart;
    std::chrono::milliseconds stop_limit{10000};  ///< until a worker that is told to stop is ended by force
    const config::Clock* clock = nullptr;         ///< not null
    /// Runs a function later on the fleet's thread, in order; called on any thread.
    std::function<void(std::function<void()>)> post;
    std::function<void()> on_change;  ///< states() has changed; called on the fleet's thread
  };
  WorkerFleet(WorkerLauncher& launcher, Options options);

  /// Adopts the workers that an earlier run of the pool left. \return their places
  std::vector<discovery::PlaceId> adopt();
  /// From now on the place is to run this version. A worker with another one is drained and ended first. A place that
  /// was left alone tries again only with another version.
  void run(const WorkerOrder& order);
  /// Drains and ends the place's worker; then the place is gone from states(). \param limit until it is ended by force
  void end(const discovery::PlaceId& place, std::chrono::milliseconds limit);
  void end(const discovery::PlaceId& place) { end(place, options_.stop_limit); }
  /// The place's worker ends by itself, and no other follows; it is told to stop when `limit` has passed. One that does
  /// not run yet ends now.
  void let_end(const discovery::PlaceId& place, std::chrono::milliseconds limit);
  bool has(const discovery::PlaceId& place) const { return places_.contains(place); }

  /// Starts and stops what is due. \return when to call it again; nullopt: not before something else happens
  std::optional<config::Clock::Instant> do_due();

  std::vector<discovery::PlaceStatus> states() const;  ///< without the pool's id

 private:
  struct Place {
    std::optional<WorkerOrder> order;  ///< what it is to run; nullopt: its worker goes on as it was adopted
    std::unique_ptr<WorkerLink> link;  ///< null: no worker runs
    std::int64_t life = 0;             ///< which worker the link is to: events of another one are late
    std::int64_t runs_version = 0;     ///< of the worker behind the link
    bool stopping = false;             ///< the worker behind the link was told to stop
    bool ending = false;               ///< no other worker follows
    std::optional<config::Clock::Instant> start_at, stop_at;
    processes::Restarts restarts;
    std::string last_failure;
    discovery::PlaceStatus status;
  };
  WorkerEvents events_of(const discovery::PlaceId& id, std::int64_t life);
  void start(const discovery::PlaceId& id, Place& place);
  void heard(const discovery::PlaceId& id, const pooled::WorkerReport& report);
  void ended(const discovery::PlaceId& id, const WorkerEnding& ending);
  void failed(const discovery::PlaceId& id, Place& place, const std::string& reason);
  void leave_alone(const discovery::PlaceId& id, Place& place, const std::string& reason);
  void show(Place& place, const std::string& state, const std::string& reason);

  WorkerLauncher& launcher_;
  const Options options_;
  std::int64_t lives_ = 0;  ///< workers that were started or adopted so far
  std::map<discovery::PlaceId, Place> places_;
  std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);  ///< posted events of a fleet that is gone do nothing
};

}  // namespace iotcloud::topology
