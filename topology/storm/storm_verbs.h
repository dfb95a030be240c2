#pragma once

#include <chrono>
#include <iosfwd>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <iotcloud/config/output/output.h>

namespace iotcloud::topology::storm {

/// What all verbs of `iotcloud-storm` are given.
struct StormCall {
  std::vector<std::string> nimbus;   ///< HOST:PORT; empty: those of the topology's file
  std::vector<std::string> folders;  ///< where component libraries are that are not beside the topology's file
  std::ostream& out;                 ///< results
  config::output::Format format = config::output::Format::table;
  std::chrono::seconds patience{30};  ///< for how long a leader is looked for
};

// Each prints what it did, in JSON and YAML under the keys that `iotcloud topology` has, as far as they mean the same,
// and notes and progress to stderr. \return the exit status. \throws config::Error

/// \param file a topology's, or a component library (.so) for Flux and Java. \param onto a jar that is taken along
int pack(const StormCall& call, const std::string& file, const std::string& jar, const std::string& onto);
/// \param limit for how long it waits until all tasks run; 0: not at all
int submit(const StormCall& call, const std::string& file, std::optional<int> workers, std::chrono::seconds limit);
/// \param watch as of config::output::watch()
int list(const StormCall& call, double watch);
int show(const StormCall& call, const std::string& name);
/// \param watch as of config::output::watch()
int metrics(const StormCall& call, const std::string& name, const std::string& window, double watch);
int errors(const StormCall& call, const std::string& name);
int set_active(const StormCall& call, const std::string& name, bool active);
/// \param wait for how long the spouts pause before the workers change
/// \param limit for how long, after that, it waits until all tasks run; 0: not at all
int rebalance(const StormCall& call, const std::string& name, std::optional<int> workers,
              const std::map<std::string, int>& executors, std::chrono::seconds wait, std::chrono::seconds limit);
/// \param levels by logger's name; empty: as before. \param time_out after which they are as before; 0: none
int set_log_levels(const StormCall& call, const std::string& name, const std::map<std::string, std::string>& levels,
                   std::chrono::seconds time_out);
int kill(const StormCall& call, const std::string& name, std::chrono::seconds wait);

}  // namespace iotcloud::topology::storm
