#pragma once

#include <string>

#include <iotcloud/topology/pool/place_shares.h>

/// What pools see of a fleet, as tests put it together.
namespace iotcloud::topology::views {

inline discovery::PoolRecord pool(const std::string& id) {
  discovery::PoolRecord record;
  record.id = discovery::PoolId(id);
  record.host = "h";
  return record;
}

inline discovery::Submission submission(const std::string& name, int workers, std::int64_t version = 1) {
  discovery::Submission submission;
  submission.name = discovery::TopologyName(name);
  submission.workers = workers;
  submission.last_number = version;
  submission.version = {version, "yaml of version " + std::to_string(version), {}, ""};
  return submission;
}

inline void hold(PoolView& view, const std::string& topology, int place, const std::string& pool) {
  view.holders[{discovery::TopologyName(topology), place}] = {discovery::PoolId(pool), ""};
}

}  // namespace iotcloud::topology::views
