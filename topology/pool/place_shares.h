#pragma once

#include <map>
#include <vector>

#include <iotcloud/discovery/submissions.h>

namespace iotcloud::topology {

/// What the pools of a fleet see of each other, and of what is ordered.
struct PoolView {
  std::vector<discovery::PoolRecord> pools;  ///< those that live
  std::map<discovery::TopologyName, discovery::Submission> submissions;
  std::map<discovery::PlaceId, discovery::PlaceHolder> holders;
};

/// Shares the worker places of all submitted topologies among the pools that live: their numbers of workers differ by
/// one at most, as far as pools have the topologies' libraries and room. A pool keeps the places that it holds, unless
/// another one has two less. The answer depends on the view only, so every pool that sees the same comes to the same
/// answer. Places of killed topologies, and those that no pool can take, are missing.
std::map<discovery::PlaceId, discovery::PoolId> share_places(const PoolView& view);

}  // namespace iotcloud::topology
