#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/topology_context.h>
#include <iotcloud/topology/value.h>

namespace iotcloud::topology {

/// Chooses the tasks that get a tuple. Each emitting task has its own object for each input that reads it, so no two
/// calls of one object overlap.
class Grouping {
 public:
  virtual ~Grouping() = default;
  /// \param targets ids of the receiving component's tasks, ascending, at least one; constant, and outlives this
  /// object.
  virtual void prepare(const TopologyContext& emitter, const Fields& fields, std::span<const int> targets) = 0;
  /// Appends the ids of the chosen tasks to `chosen`.
  virtual void choose(const Values& values, std::vector<int>& chosen) = 0;
};

namespace detail {

/// A grouping that chooses one task for each tuple. The runtime asks it for the task's place, which needs no list.
class ToOneGrouping : public Grouping {
 public:
  void prepare(const TopologyContext&, const Fields&, std::span<const int> targets) override { targets_ = targets; }
  void choose(const Values& values, std::vector<int>& chosen) final { chosen.push_back(targets_[place(values)]); }
  /// \return the chosen task's place among the targets.
  virtual std::size_t place(const Values& values) = 0;

 protected:
  std::span<const int> targets_;
};

}  // namespace detail

using GroupingFactory = std::function<std::unique_ptr<Grouping>()>;

/// The names of the groupings in YAML: shuffle (the tasks in turn), fields (tuples with the same key go to the same
/// task, by stable_hash), partial_key (a key has two candidate tasks, and the emitter takes the one to which it has
/// sent less), all (every task), global (the task with the lowest id), none (same as shuffle), local_or_shuffle (same
/// as shuffle, because a tuple does not leave its worker). `direct` is not listed: emit_direct() names the task itself.
const std::vector<std::string>& grouping_names();
/// The place, among a component's tasks in the order of their ids, of the one that the grouping `fields` chooses for a
/// key. The same in every process, build and version. \param key the values of the grouping's fields, in their order.
/// \param tasks how many tasks there are; at least 1.
std::size_t task_of_key(const Values& key, std::size_t tasks);
/// \param fields the key of `fields` and `partial_key`. \throws std::invalid_argument for an unknown name.
GroupingFactory make_grouping(const std::string& name, const Fields& fields = {});

}  // namespace iotcloud::topology
