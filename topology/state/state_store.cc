#include <algorithm>
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
    give_to_the_tasks_of(owner);
    const auto found = states_.find(place_of(owner, owner.task_index));
    return found == states_.end() ? StoredState{} : found->second;
  }
  void commit(const StateOwner& owner, const Checkpoint& checkpoint) override {
    const config::MutexLock lock(mutex_);
    int& count = task_counts_.try_emplace({owner.topology, owner.component}, owner.task_count).first->second;
    internal::check_task_count(owner, count);
    StoredState& state = states_[place_of(owner, owner.task_index)];
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
  using Place = std::tuple<std::string, std::string, int>;
  static Place place_of(const StateOwner& owner, int task) { return {owner.topology, owner.component, task}; }

  void give_to_the_tasks_of(const StateOwner& owner) IOTCLOUD_REQUIRES(mutex_) {
    const auto known = task_counts_.find({owner.topology, owner.component});
    if (known == task_counts_.end() || known->second == owner.task_count) return;
    std::vector<StoredState> stored;
    stored.reserve(static_cast<std::size_t>(known->second));
    for (int task = 0; task < known->second; ++task) stored.push_back(states_[place_of(owner, task)]);
    std::vector<StoredState> given = internal::rehashed(owner, stored);
    for (int task = 0; task < known->second; ++task) states_.erase(place_of(owner, task));
    for (int task = 0; task < owner.task_count; ++task) {
      states_[place_of(owner, task)] = std::move(given[static_cast<std::size_t>(task)]);
    }
    known->second = owner.task_count;
  }
  config::Mutex mutex_;
  std::map<std::pair<std::string, std::string>, int> task_counts_ IOTCLOUD_GUARDED_BY(mutex_);
  std::map<Place, StoredState> states_ IOTCLOUD_GUARDED_BY(mutex_);
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

std::string quoted(std::string_view key) {
  static constexpr std::size_t shown = 64;
  static constexpr const char* digits = "0123456789abcdef";
  std::string text = "\"";
  for (const char each : key.substr(0, shown)) {
    const auto byte = static_cast<unsigned char>(each);
    if (byte >= 0x20 && byte < 0x7f && each != '"' && each != '\\') {
      text += each;
    } else {
      text += {'\\', 'x', digits[byte >> 4U], digits[byte & 0xfU]};
    }
  }
  return text + (key.size() > shown ? "...\"" : "\"");
}

void check_task_count(const StateOwner& owner, int stored) {
  if (stored == owner.task_count) return;
  throw StateError("the state of component \"" + owner.component + "\" of topology \"" + owner.topology +
                   "\" was given to " + std::to_string(stored) + " tasks, and this is one of " +
                   std::to_string(owner.task_count) + "; end the topology that runs with the other number of tasks");
}

std::vector<StoredState> rehashed(const StateOwner& owner, const std::vector<StoredState>& stored) {
  const auto refusal = [&](const std::string& why) {
    return StateError("the state of component \"" + owner.component + "\" of topology \"" + owner.topology +
                      "\" was written by " + std::to_string(stored.size()) + " tasks, and now there are " +
                      std::to_string(owner.task_count) + "; " + why +
                      ". Set the old number of tasks again (the parallelism may change), or keep the state in Redis, "
                      "or name another store (state.store) to begin anew");
  };
  const auto count = static_cast<std::size_t>(owner.task_count);
  std::vector<StoredState> given(count);
  for (const StoredState& each : stored) {
    for (StoredState& state : given) state.version = std::max(state.version, each.version);
  }
  for (std::size_t task = 0; task < stored.size(); ++task) {
    for (const auto& [key, value] : stored[task].entries) {
      if (count == 1) {  // every tuple comes to this task, whoever uses the key
        if (given.front().entries.emplace(key, value).second) continue;
        throw refusal("more than one task has the key " + quoted(key) + ", each with a value of its own");
      }
      const auto was = owner.task_of ? owner.task_of(key, stored.size()) : std::nullopt;
      if (!was) {
        throw refusal("nothing says which task uses the key " + quoted(key) +
                      " now. If all inputs have the grouping `fields` and each key is the text of its one field, "
                      "write \"state.keys: grouping\"; otherwise let the bolt say it (StatefulBolt::grouping_key)");
      }
      if (*was != task) {
        throw refusal("task " + std::to_string(task) + " has the key " + quoted(key) + ", but the tuples of this key " +
                      "went to task " + std::to_string(*was) +
                      ". So the key is not what the tuples are grouped by, or the grouping was another one when it "
                      "was written");
      }
      given[owner.task_of(key, count).value()].entries.emplace(key, value);
    }
  }
  return given;
}

}  // namespace internal

std::shared_ptr<StateStore> make_state_store(const std::string& url) {
  static OpenStores stores;
  return stores.open(url);
}

}  // namespace iotcloud::topology
