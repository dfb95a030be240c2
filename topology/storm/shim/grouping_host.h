#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <iotcloud/topology/grouping.h>
#include <iotcloud/topology/storm/shim/task_description.h>

namespace iotcloud::topology::storm {

/// A custom grouping of one emitting task. Used by one thread at a time.
class GroupingHost {
 public:
  /// \param emitter its folder, file, topology, component, task and tasks, and the stream as its one output.
  /// \param bolt whose input has the grouping. \param input its number.
  /// \throws config::Error when there is no such grouping, and what the grouping's prepare() throws.
  GroupingHost(const TaskDescription& emitter, const std::string& bolt, std::size_t input, std::vector<int> targets);

  /// Chooses the tasks that get a tuple. \param values as in value_format.h. \param chosen receives their ids.
  /// \return how many they are. \throws what the grouping throws, and std::invalid_argument for a task that does not
  /// read the stream, or when `chosen` is too small.
  std::size_t choose(std::span<const std::byte> values, std::span<std::int32_t> chosen);

 private:
  const std::vector<int> targets_;
  const TopologyContext emitter_;
  const TaskDescription::Output stream_;
  std::unique_ptr<Grouping> grouping_;
  std::vector<int> chosen_;
};

}  // namespace iotcloud::topology::storm
