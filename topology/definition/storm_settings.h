#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/yaml.h>

namespace iotcloud::topology {

/// How Apache Storm runs the topology (`engine.storm`); our own workers do not read it.
struct StormSettings {
  std::vector<std::string> nimbus;                    ///< host:port of Storm's masters; empty: a person names them
  int workers = 1;                                    ///< worker processes
  std::optional<int> ackers;                          ///< executors that track tuples; empty: one for each worker
  std::chrono::microseconds spout_wait{1000};         ///< how long a spout's executor parks when it has nothing to emit
  std::chrono::microseconds bolt_wait{200};           ///< how long a bolt's executor parks when it has no tuple
  std::chrono::microseconds back_pressure_wait{200};  ///< how long an executor parks when a receiver's queue is full
  std::string worker_options;                         ///< more options of the workers' JVMs
  std::vector<std::string> shared_folders;            ///< folders that all machines of the cluster have in common
  std::map<std::string, std::string> conf;            ///< keys of Storm ("topology.debug"), with JSON or text
};

/// Reads `engine`. \throws config::ConfigError.
StormSettings read_storm_settings(config::YamlSection& root);

}  // namespace iotcloud::topology
