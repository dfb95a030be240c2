#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>

namespace iotcloud::topology {

/// The configuration of a component: `conf` of the topology overlaid with `conf` of the component.
using Config = std::map<std::string, std::string>;

/// Wakes one spout task. Copy it freely; thread safe; harmless after the runtime is gone.
class SpoutWaker {
 public:
  class Target {
   public:
    virtual ~Target() = default;
    virtual void wake() noexcept = 0;
  };
  SpoutWaker() = default;
  explicit SpoutWaker(std::weak_ptr<Target> target) : target_(std::move(target)) {}
  /// next_tuple will be called: on this very thread when the task is idle, together with all the bolts that its tuples
  /// reach, for about a millisecond of work; what is left then goes on in the runtime's own threads. Call it without
  /// holding a lock that the spout's methods take.
  void wake() const noexcept {
    if (const auto target = target_.lock()) target->wake();
  }

 private:
  std::weak_ptr<Target> target_;
};

/// What a task is told about its place. Lives as long as the task; everything is constant.
struct TopologyContext {
  std::string topology;   ///< name
  std::string component;  ///< id of the component that this is a task of
  int task = 0;           ///< unique in the topology, from 1
  int task_index = 0;     ///< 0 .. task_count - 1, within the component
  int task_count = 1;
  /// The tasks of every component, ascending; shared by all contexts.
  std::shared_ptr<const std::map<std::string, std::vector<int>>> tasks_of;
  std::vector<std::pair<std::string, std::string>>
      inputs;  ///< bolts: the components and streams that feed it, each once
  const config::Clock* clock = nullptr;
  config::Metrics* metrics = nullptr;
  SpoutWaker waker;  ///< spouts only
};

}  // namespace iotcloud::topology
