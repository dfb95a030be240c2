#pragma once

#include <memory>
#include <string>

#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::internal {

/// Opens the RocksDB in this folder, or makes it. \throws StateError, also when something else is there.
std::shared_ptr<StateStore> open_rocksdb(const std::string& path);

/// \throws StateError when the state was written by another number of tasks.
void check_task_count(const StateOwner& owner, int stored);

}  // namespace iotcloud::topology::internal
