#pragma once

#include <iosfwd>

#include <iotcloud/master/cli/command.h>

namespace iotcloud::master::cli {

/// `iotcloud keys new`: PATH.key, which only its owner may read, and PATH.pub for the gateways. Never overwrites.
/// `iotcloud sign`: FILE.sig for a plugin. Neither asks a master. \throws config::Error. \return the exit status
int make_keys(const Command& command, std::ostream& out);
int sign_plugin(const Command& command, std::ostream& out);

}  // namespace iotcloud::master::cli
