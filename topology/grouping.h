#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/topology_context.h>
#include <iotcloud/topology/value.h>

namespace iotcloud::topology {

/// Chooses the tasks that get a tuple. One object for each emitting task and subscription; calls are serial.
class Grouping {
 public:
  virtual ~Grouping() = default;
  /// \param targets the tasks of the receiving component, ascending, at least one; constant, and there,
  /// for the object's life.
  virtual void prepare(const TopologyContext& emitter, const Fields& fields, std::span<const int> targets) = 0;
  /// Appends the chosen tasks to `chosen`.
  virtual void choose(const Values& values, std::vector<int>& chosen) = 0;
};

using GroupingFactory = std::function<std::unique_ptr<Grouping>()>;

/// The groupings by name, as YAML knows them: shuffle (even, in turn), fields (same key, same task, by stable_hash),
/// partial_key (the less used by this emitter of two candidates for a key), all, global (lowest task), none (as
/// shuffle), local_or_shuffle (as shuffle within one worker). `direct` is no function: emit_direct chooses.
const std::vector<std::string>& grouping_names();
/// \param fields for `fields` and `partial_key`: the key. \throws std::invalid_argument for a name that is none.
GroupingFactory make_grouping(const std::string& name, const Fields& fields = {});

}  // namespace iotcloud::topology
