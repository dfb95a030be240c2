#pragma once

#include <functional>
#include <iosfwd>
#include <memory>

#include <iotcloud/master/cli/command.h>

namespace iotcloud::master::cli {

class MasterClient;

/// `iotcloud diff` and `iotcloud apply`: a manifest, and what makes the fleet so.
/// \param connect makes a connection to the masters. \return the exit status: exit_differs when something is to be done
/// and was not, for it was only asked what.
/// \throws config::ConfigError for the manifest, before a master is asked; Unreachable, Failed.
int run_fleet(const Command& command, const std::function<std::unique_ptr<MasterClient>()>& connect, std::ostream& out,
              std::ostream& err);

}  // namespace iotcloud::master::cli
