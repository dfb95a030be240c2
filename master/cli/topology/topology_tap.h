#pragma once

#include <iosfwd>

#include "iotcloud/master/master_types.h"
#include <iotcloud/master/cli/command.h>

namespace iotcloud::master::cli {

/// Shows samples of the tuples of a component, of all workers, until there are enough or it is interrupted; the
/// workers' taps end with it. \return the exit status. \throws Failed
int tap(const Command& command, const wire::TTopology& topology, std::ostream& out, std::ostream& err);

}  // namespace iotcloud::master::cli
