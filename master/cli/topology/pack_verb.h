#pragma once

#include <memory>

#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

/// The verb that makes a jar of a topology, for Apache Storm.
std::unique_ptr<Verb> pack_topology_verb();

}  // namespace iotcloud::master::cli
