#pragma once

#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/topology/runtime/scheduling/executors.h>
#include <iotcloud/topology/runtime/tasks/bolt_task.h>
#include <iotcloud/topology/runtime/tasks/spout_task.h>

namespace iotcloud::topology::internal {

/// All tasks of a topology, connected. Constant once it is made, the tasks' own state apart.
class TaskGraph {
 public:
  /// Makes the tasks; starts nothing. `topology` outlives it. \throws TopologyError when a factory or a grouping
  /// throws.
  TaskGraph(const Topology& topology, Surroundings around, config::Metrics& metrics);
  /// When nothing runs any task any more.
  ~TaskGraph();
  TaskGraph(const TaskGraph&) = delete;
  TaskGraph& operator=(const TaskGraph&) = delete;

  /// Prepares bolts before what feeds them, and opens spouts. \throws TopologyError when one throws: those that were
  /// opened are closed again.
  void prepare(Lane& lane);

  const std::vector<std::unique_ptr<Task>>& tasks() const { return tasks_; }  ///< sources before those they feed
  const std::vector<SpoutTask*>& spouts() const { return spouts_; }
  const ComponentSpec& spec_of(const Task& task) const;
  const std::map<std::string, std::vector<int>>& tasks_of() const { return *tasks_of_; }
  std::map<std::string, Executors>& executors() { return executors_; }  ///< by component
  const std::map<std::string, Executors>& executors() const { return executors_; }

 private:
  void name_tasks();
  TopologyContext context_of(const ComponentSpec& spec, std::size_t index) const;
  void make_tasks(const ComponentSpec& spec);
  Intake intake_of(const ComponentSpec& bolt) const;
  std::vector<OutStream> streams_of(const Task& emitter) const;

  const Topology& topology_;
  Surroundings around_;
  config::Metrics& metrics_;
  std::shared_ptr<const std::map<std::string, std::vector<int>>> tasks_of_;
  std::map<std::string, Executors> executors_;
  std::map<std::pair<std::string, std::string>, detail::StreamInfo> stream_infos_;  ///< nodes stay where they are
  const detail::StreamInfo tick_stream_{system_component, tick_stream, {}};
  std::vector<std::unique_ptr<Task>> tasks_;
  std::vector<BoltTask*> bolts_;  ///< by task id; null where that is no bolt
  std::vector<SpoutTask*> spouts_;
};

}  // namespace iotcloud::topology::internal
