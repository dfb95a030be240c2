#pragma once

#include <iotcloud/master/cli/command.h>

namespace CLI {
class App;
}

namespace iotcloud::master::cli {

/// The subcommands `certs` and `token`. \param command outlives the parsing.
void add_security(CLI::App& app, Command& command);

}  // namespace iotcloud::master::cli
