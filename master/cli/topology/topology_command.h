#pragma once

#include <iosfwd>
#include <string>

#include "iotcloud/master/master_types.h"
#include <iotcloud/master/cli/command.h>

namespace iotcloud::master::cli {

class MasterClient;

/// `iotcloud topology ...`: orders by way of the master, numbers and samples from the workers' own pages.
/// \return the exit status. \throws Unreachable, Failed
int run_topology(const Command& command, MasterClient& master, std::ostream& out, std::ostream& err);

/// Becomes the program that knows topologies, with --check FILE. \return only when it is not there.
int check_topology(const Command& command, std::ostream& err);

/// "active", "inactive", "killed", "draining"; "mixed" while not all of its workers have followed.
std::string topology_state(const wire::TTopology& topology);
const char* word(wire::TOutcome::type outcome);

}  // namespace iotcloud::master::cli
