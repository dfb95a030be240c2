#pragma once

#include <memory>
#include <string>

#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::internal {

/// Opens or makes the RocksDB in this folder. \throws StateError, also if the folder has other data.
std::shared_ptr<StateStore> open_rocksdb(const std::string& path);

/// Checks that the state of `owner` was written by as many tasks as it has now. \param stored number of tasks that
/// wrote it. \throws StateError if the numbers differ.
void check_task_count(const StateOwner& owner, int stored);

}  // namespace iotcloud::topology::internal
