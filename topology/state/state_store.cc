#include <string_view>
#include <tuple>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/state/redis/redis_store.h>
#include <iotcloud/topology/state/rocksdb/rocksdb_store.h>
#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology {

namespace {

class MemoryStore final : public StateStore {
 public:
  StoredState load(const StateOwner& owner) override {
    const config::MutexLock lock(mutex_);
    check(owner);
    const auto found = states_.find({owner.topology, owner.component, owner.task_index});
    return found == states_.end() ? StoredState{} : found->second;
  }
  void commit(const StateOwner& owner, const Checkpoint& checkpoint) override {
    const config::MutexLock lock(mutex_);
    check(owner);
    task_counts_[{owner.topology, owner.component}] = owner.task_count;
    StoredState& state = states_[{owner.topology, owner.component, owner.task_index}];
    state.version = checkpoint.version;
    for (const auto& [key, value] : checkpoint.changes) {
      if (value) {
        state.entries[key] = *value;
      } else {
        state.entries.erase(key);
      }
    }
  }

 private:
  void check(const StateOwner& owner) const IOTCLOUD_REQUIRES(mutex_) {
    const auto known = task_counts_.find({owner.topology, owner.component});
    if (known != task_counts_.end()) internal::check_task_count(owner, known->second);
  }
  config::Mutex mutex_;
  std::map<std::pair<std::string, std::string>, int> task_counts_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<std::tuple<std::string, std::string, int>, StoredState> states_ IOTCLOUD_GUARDED_BY(mutex_);
};

/// The open stores of this process. It keeps stores in memory for ever, because nothing else has their data, and other
/// stores as long as they are used.
class OpenStores {
 public:
  std::shared_ptr<StateStore> open(const std::string& url) {
    static constexpr std::string_view memory = "memory://", rocksdb = "rocksdb://";
    const config::MutexLock lock(mutex_);
    if (auto store = used_[url].lock()) return store;
    std::shared_ptr<StateStore> store;
    if (url.starts_with(memory) && url.size() > memory.size()) {
      store = kept_.emplace_back(std::make_shared<MemoryStore>());
    } else if (url.starts_with(rocksdb) && url.size() > rocksdb.size() + 1 && url[rocksdb.size()] == '/') {
      store = internal::open_rocksdb(url.substr(rocksdb.size()));
    } else if (url.starts_with("redis://") || url.starts_with("rediss://")) {
      store = internal::open_redis(url);
    } else {
      used_.erase(url);
      throw StateError("\"" + url +
                       "\" is no state store; write memory://NAME, rocksdb:///absolute/path or redis://HOST:PORT");
    }
    used_[url] = store;
    return store;
  }

 private:
  config::Mutex mutex_;
  std::map<std::string, std::weak_ptr<StateStore>> used_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<std::shared_ptr<StateStore>> kept_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace

namespace internal {

void check_task_count(const StateOwner& owner, int stored) {
  if (stored == owner.task_count) return;
  throw StateError("the state of component \"" + owner.component + "\" of topology \"" + owner.topology +
                   "\" was written by " + std::to_string(stored) + " tasks, and now there are " +
                   std::to_string(owner.task_count) +
                   ", so keys would go to other tasks. Set the old number of tasks again (the parallelism may change), "
                   "or name another "
                   "store (state.store) to begin anew");
}

}  // namespace internal

std::shared_ptr<StateStore> make_state_store(const std::string& url) {
  static OpenStores stores;
  return stores.open(url);
}

}  // namespace iotcloud::topology
