#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/fields.h>

namespace iotcloud::topology {

/// A component's configuration: the topology's `conf`, overridden by the component's.
using Config = std::map<std::string, std::string>;

/// Wakes one spout task from any thread. A copy wakes the same task. It may outlive the runtime, and then does nothing.
class SpoutWaker {
 public:
  /// The target of a waker; implemented by the runtime that runs the task.
  class Target {
   public:
    virtual ~Target() = default;
    virtual void wake() noexcept = 0;
  };
  SpoutWaker() = default;
  explicit SpoutWaker(std::weak_ptr<Target> target) : target_(std::move(target)) {}
  /// Makes the runtime call next_tuple(). If the task is idle, the calling thread runs it, and the bolts that its
  /// tuples reach, for about a millisecond (RuntimeOptions::caller_slice); threads of the pool run what is left. The
  /// caller must not hold a lock that the spout's methods take.
  void wake() const noexcept {
    if (const auto target = target_.lock()) target->wake();
  }

 private:
  std::weak_ptr<Target> target_;
};

/// Where components say what hinders them now, for the worker's /healthz, `iotcloud status` and `iotcloud topology
/// show`. An error that is over belongs to report_error(). Implementations are thread safe.
class Troubles {
 public:
  virtual ~Troubles() = default;
  /// \param component its id. \param part tells the troubles of one component apart: its task, say.
  /// \param text what hinders it and how to mend that; it replaces the part's text before; empty: nothing any more
  virtual void set(const std::string& component, const std::string& part, const std::string& text) = 0;
};

/// What a task keeps in memory now, for the worker's page and its metrics; -1: it keeps nothing of the kind. The task
/// sets it, any thread reads it.
struct Holdings {
  std::atomic<std::int64_t> window_tuples{-1};  ///< tuples that later windows may hold
  std::atomic<std::int64_t> state_entries{
      -1};                                    ///< keys of its state; of a shared store those since the last checkpoint
  std::atomic<std::int64_t> state_bytes{-1};  ///< of these keys and their values, a few seconds old
};

/// A task's place in the topology. Constant; lives as long as the task.
struct TopologyContext {
  std::string topology;   ///< the topology's name
  std::string component;  ///< id of the task's component
  int task = 0;           ///< unique in the topology, from 1
  int task_index = 0;     ///< 0 .. task_count - 1, within the component
  int task_count = 1;     ///< number of the component's tasks in this worker
  /// The ids of the tasks of every component, ascending; all contexts share this map.
  std::shared_ptr<const std::map<std::string, std::vector<int>>> tasks_of;
  std::vector<std::pair<std::string, std::string>>
      inputs;                            ///< for bolts: each pair of component and stream that feeds the task
  const config::Clock* clock = nullptr;  ///< the topology's clock, simulated in tests; never null in a running task
  config::Metrics* metrics = nullptr;    ///< where a component adds its own metrics; never null in a running task
  SpoutWaker waker;                      ///< for spouts; a bolt's does nothing
  /// For bolts, beside each of `inputs`: the fields whose values choose the task (the grouping `fields`); empty:
  /// something else chooses it.
  std::vector<Fields> input_keys;
  Troubles* troubles = nullptr;  ///< never null in a running task
  Holdings* holdings = nullptr;  ///< the task's; null where nobody asks for them (Storm)
};

}  // namespace iotcloud::topology
