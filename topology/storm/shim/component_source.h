#pragma once

#include <memory>
#include <string>

#include <iotcloud/topology/grouping.h>
#include <iotcloud/topology/storm/shim/endpoint_process.h>
#include <iotcloud/topology/storm/shim/task_description.h>
#include <iotcloud/topology/topology_builder.h>

namespace iotcloud::topology::storm {

/// The name of a topology's file in the jar.
inline constexpr const char* topology_file = "topology.yaml";

/// A task's component.
struct Component {
  ComponentSpec spec;                    ///< its `config` is complete
  EndpointProcess* endpoints = nullptr;  ///< if it faces a broker; lives until the process ends
};

/// The component of a task: of the topology's file, which is read once in a process, or of a component library alone.
/// Thread safe. \throws config::Error for a file or library that cannot be used, and for a component that is not in it.
Component component_of(const TaskDescription& task);

/// A custom grouping, made anew: of an input of a bolt of the topology's file, or of a component library alone.
/// \param emitter says which file, or which library and class. \param input the number of the bolt's input.
/// \throws config::Error as component_of().
std::unique_ptr<Grouping> grouping_of(const TaskDescription& emitter, const std::string& bolt, std::size_t input);

}  // namespace iotcloud::topology::storm
