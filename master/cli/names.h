#pragma once

#include <string>
#include <vector>

#include <iotcloud/master/cli/command.h>

namespace iotcloud::master::cli {

/// What a master knows names of.
enum class NameKind { gateways, instances, drivers, deployments, topologies };

/// All names of a kind, asked of the command's masters. \throws std::exception when none answers.
std::vector<std::string> names_of(NameKind kind, const Command& command);

}  // namespace iotcloud::master::cli
