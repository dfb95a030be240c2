#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

/// A topology's state: "active", "inactive", "killed", "draining"; "mixed" while its workers are in different states.
/// One without a worker is "no worker", or as it was ordered to be: "inactive", "killed".
std::string topology_state(const discovery::TopologyStatus& topology);
/// The revision of the last order to a topology; 0: there is no order.
std::int64_t revision_of(const discovery::TopologyStatus& topology);

/// Adds the verbs of topologies that pools run to those of the group.
void add_submission_verbs(Verbs& group);

/// The verb that lists topologies, which has two names.
std::unique_ptr<Verb> list_topologies_verb(const char* name, const char* what, const char* example);

}  // namespace iotcloud::master::cli
