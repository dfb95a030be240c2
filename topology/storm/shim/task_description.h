#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/topology/fields.h>
#include <iotcloud/topology/topology_context.h>

namespace iotcloud::topology::storm {

/// The name of the hidden last field of streams whose tuples say when their spout emitted the root of their tree, in
/// milliseconds since 1970 UTC. Components do not see it.
inline constexpr const char* birth_field = "__born";

/// What Java says of a task of Storm's when it opens it, as JSON: where the component's code is, and what Storm's own
/// context of the task has.
struct TaskDescription {
  /// A stream, with the fields that components see.
  struct Stream {
    std::string component;
    std::string stream;
    Fields fields;
    bool births = false;  ///< its tuples have the birth_field, too
  };
  /// A stream that the task reads.
  struct Input : Stream {
    Fields key;  ///< of the grouping `fields`
  };
  /// A stream that the task emits.
  struct Output : Stream {
    bool direct = false;
    std::vector<int> targets;  ///< the tasks that read it, ascending; only of a direct stream
    /// Each tuple goes to one task of a bolt of C++, which may be in this process: one with a large payload travels in
    /// a parcel (parcel.h).
    bool parcels = false;
    std::vector<std::size_t> told;  ///< the places of the values by which Storm groups such a stream's tuples
  };

  /// \throws config::Error when the text is none: the jar's Java and C++ are of different builds.
  static TaskDescription parse(std::string_view json);

  std::string folder;      ///< with the topology's file and all libraries
  std::string file;        ///< the topology's file in it, which has the component; empty: the next three say it
  std::string library;     ///< the component library in the folder
  std::string class_name;  ///< the component's class in it
  Config conf;             ///< the component's

  std::string topology;
  std::string component;
  int task = 0;
  std::map<std::string, std::vector<int>> tasks;  ///< of every component, ascending
  std::vector<int> here;                          ///< the tasks of this component that run in this process, ascending
  std::vector<Input> inputs;
  std::vector<Output> outputs;

  /// The context for the task's component; the caller adds clock, metrics, waker and troubles.
  TopologyContext context() const;
};

}  // namespace iotcloud::topology::storm
