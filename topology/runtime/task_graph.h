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

/// All tasks of a topology, connected. Only the tasks' own state changes after the constructor.
class TaskGraph {
 public:
  /// Makes the tasks; starts nothing. `topology` must outlive the graph. \throws TopologyError when a factory or a
  /// grouping throws.
  TaskGraph(const Topology& topology, TaskEnvironment environment, config::Metrics& metrics);
  /// \pre no thread runs a task any more.
  ~TaskGraph();
  TaskGraph(const TaskGraph&) = delete;
  TaskGraph& operator=(const TaskGraph&) = delete;

  /// Prepares bolts and opens spouts, each component before those that feed it. \throws TopologyError when one of them
  /// throws, after closing those that were opened before.
  void prepare(EmittingLane& lane);

  /// Sources stand before the bolts that they feed.
  const std::vector<std::unique_ptr<Task>>& tasks() const { return tasks_; }
  const std::vector<SpoutTask*>& spouts() const { return spouts_; }
  const ComponentSpec& spec_of(const Task& task) const;
  const std::map<std::string, std::vector<int>>& tasks_of() const { return *tasks_of_; }
  std::map<std::string, Executors>& executors() { return executors_; }  ///< by component
  const std::map<std::string, Executors>& executors() const { return executors_; }

 private:
  void name_tasks();
  TopologyContext context_of(const ComponentSpec& spec, std::size_t index) const;
  void make_tasks(const ComponentSpec& spec);
  InputPolicies input_policies_of(const ComponentSpec& bolt) const;
  std::vector<OutStream> streams_of(const Task& emitter) const;

  const Topology& topology_;
  TaskEnvironment environment_;
  config::Metrics& metrics_;
  std::shared_ptr<const std::map<std::string, std::vector<int>>> tasks_of_;
  std::map<std::string, Executors> executors_;
  /// Tuples point to the values, which a map never moves.
  std::map<std::pair<std::string, std::string>, detail::StreamInfo> stream_infos_;
  const detail::StreamInfo tick_stream_{system_component, tick_stream, {}};
  std::vector<std::unique_ptr<Task>> tasks_;
  std::vector<BoltTask*> bolts_;  ///< index: task id; null for a spout's task
  std::vector<SpoutTask*> spouts_;
};

}  // namespace iotcloud::topology::internal
