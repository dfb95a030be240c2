#pragma once

#include <memory>
#include <string>
#include <vector>

#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology::internal {

/// Opens or makes the RocksDB in this folder. \throws StateError, also if the folder has other data.
std::shared_ptr<StateStore> open_rocksdb(const std::string& path);

/// Checks that the state of `owner` belongs to as many tasks as `owner` says. \param stored number of tasks that it
/// belongs to. \throws StateError if the numbers differ.
void check_task_count(const StateOwner& owner, int stored);

/// Gives each key of a component's state to the task that uses it now. \param stored the states of the tasks that wrote
/// it, by index. \return the states of owner.task_count tasks. \throws StateError if owner.task_of does not know a key,
/// or would not have found it where it is.
std::vector<StoredState> rehashed(const StateOwner& owner, const std::vector<StoredState>& stored);

}  // namespace iotcloud::topology::internal
