#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/topology/pool/worker_protocol.h>

namespace iotcloud::topology {

/// What a worker is to run.
struct WorkerOrder {
  discovery::PlaceId place;
  discovery::TopologyVersion version;
  /// The topology had a later version: an update is under way, failed, or was rolled back.
  bool goes_back = false;
};

/// How a worker ended.
struct WorkerEnding {
  /// Whether it may be started again.
  enum class How {
    stopped,  ///< it was told to stop
    refused,  ///< its topology cannot run here: starting it again would not help
    failed,   ///< it died, or was killed because it hung or took too much: it may be started again
  };
  How how = How::stopped;
  std::string reason;  ///< for people; empty if it was told to stop
};

/// A worker's events. The functions run on threads of the launcher, and must not call back into the link.
struct WorkerEvents {
  std::function<void(const pooled::WorkerReport&)> on_report;
  std::function<void(const WorkerEnding&)> on_ended;  ///< called once, after all other events
};

/// A pool's handle on one worker process. Thread safe.
class WorkerLink {
 public:
  /// When it has returned, no event function runs or will run. The worker goes on.
  virtual ~WorkerLink() = default;
  /// Drains the worker and ends it, by force when `limit` has passed. Then on_ended is called.
  virtual void stop(std::chrono::milliseconds limit) = 0;
};

/// A worker that an earlier run of the pool left running.
struct RunningWorker {
  std::string name;  ///< the launcher's own name for it
  discovery::PlaceId place;
  std::int64_t version = 0;
};

/// A worker cannot be started here, and to try again would not help.
class WorkerRefused : public config::Error {
 public:
  using config::Error::Error;
};

/// Starts workers of topologies.
class WorkerLauncher {
 public:
  virtual ~WorkerLauncher() = default;
  /// Starts a worker; returns at once. \throws WorkerRefused, config::Error if something lacks for now
  virtual std::unique_ptr<WorkerLink> start(const WorkerOrder& order, WorkerEvents events) = 0;
  /// The workers that outlived an earlier run of this pool.
  virtual std::vector<RunningWorker> running() = 0;
  /// Adopts one of these workers; on_report tells its state.
  virtual std::unique_ptr<WorkerLink> adopt(const RunningWorker& worker, WorkerEvents events) = 0;
};

}  // namespace iotcloud::topology
