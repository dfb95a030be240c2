#pragma once

#include <chrono>
#include <string>
#include <vector>

#include <iotcloud/topology/plugin.h>
#include <iotcloud/topology/runtime/complete_topology.h>

/// Tests a topology on a recording: link iotcloud::topology_recorded_testing.
namespace iotcloud::topology::testing {

/// How run_on_recording() runs.
struct RecordedRun {
  ComponentRegistry components{};              ///< linked-in components, in addition to those of the file's libraries
  std::vector<std::string> library_folders{};  ///< where to look for those that are not beside the file
  std::chrono::milliseconds run_for{0};        ///< how much simulated time passes after the last message
  std::chrono::milliseconds step{1};           ///< time stops at multiples of this, as in SimulatedTopology
};

/// Runs the topology of a YAML file in simulated time on a recording (`iotcloud record`), without servers and waiting:
/// each spout that faces a broker emits what its driver's channel was recorded to send, from the instances that its
/// `where` selects, when it was recorded, counted from the recording's first message. A bolt that faces a broker sends
/// nothing, and emits what it would send instead: a tuple of driver id, payload and time for each message.
/// \return what all components emitted. A spout whose driver or channel is not in the recording emits nothing.
/// \throws config::ConfigError, recording::RecordingError, and what complete_topology() throws.
CompletedTopology run_on_recording(const std::string& yaml_file, const std::string& recording,
                                   RecordedRun options = {});

}  // namespace iotcloud::topology::testing
