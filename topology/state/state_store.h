#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include <iotcloud/config/error.h>

namespace iotcloud::topology {

/// A store that cannot be opened, read or written. what() says which, why, and how to mend it.
class StateError : public config::Error {
 public:
  using Error::Error;
};

/// Whose state it is. Keys stay with their task, so it can be used by the same number of tasks only.
struct StateOwner {
  std::string topology;
  std::string component;
  int task_index = 0;
  int task_count = 1;
};

/// What a task's last checkpoint left.
struct StoredState {
  std::uint64_t version = 0;  ///< of the checkpoint; 0: there was none
  std::map<std::string, std::string, std::less<>> entries;
};

/// The changes of one task since its last checkpoint.
struct Checkpoint {
  struct Change {
    std::string key;
    std::optional<std::string> value;  ///< none: erased
  };
  std::uint64_t version = 0;  ///< one more than the last
  std::uint64_t entries = 0;  ///< how many keys there are after it
  std::span<const Change> changes;
};

/// Keeps the state of tasks. Keys and values are any bytes. Thread safe: each task looks after its own state only.
class StateStore {
 public:
  virtual ~StateStore() = default;
  /// \throws StateError when it cannot be read, is not whole, or was written by another number of tasks.
  virtual StoredState load(const StateOwner& owner) = 0;
  /// All of it or nothing; when it returns, it is durable. \throws StateError: whether it was written is not known.
  virtual void commit(const StateOwner& owner, const Checkpoint& checkpoint) = 0;
};

/// "memory://NAME": in this process, as long as it lives. "rocksdb:///path": in a folder of its own, which one process
/// at a time may use. The same URL gives the same store within a process. Thread safe.
/// \throws StateError for any other URL, and when the store cannot be opened.
std::shared_ptr<StateStore> make_state_store(const std::string& url);

}  // namespace iotcloud::topology
