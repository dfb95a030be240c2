#pragma once

#include <iosfwd>

#include <iotcloud/master/cli/command.h>

namespace iotcloud::master::cli {

/// Whether it is about certificates and tokens: files of this machine, for which no master is asked.
bool is_security(Verb verb);

/// `certs` and `token`. \return the exit status. \throws config::Error
int run_security(const Command& command, std::ostream& out);

}  // namespace iotcloud::master::cli
