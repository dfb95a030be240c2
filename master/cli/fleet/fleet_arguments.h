#pragma once

#include <iotcloud/master/cli/arguments.h>

namespace iotcloud::master::cli {

/// The verbs diff, apply, drain and undrain.
void add_fleet(CLI::App& app, Command& command, Words& words);

}  // namespace iotcloud::master::cli
