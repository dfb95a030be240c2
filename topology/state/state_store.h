#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include <iotcloud/config/error.h>

namespace iotcloud::topology {

/// Says that a store cannot be opened, read or written: which one, why, and how to mend it.
class StateError : public config::Error {
 public:
  using Error::Error;
};

/// The owner of a state. Keys stay with their task, so only the same number of tasks can use the state.
struct StateOwner {
  std::string topology;
  std::string component;
  int task_index = 0;
  int task_count = 1;
};

/// A task's state at its last checkpoint.
struct StoredState {
  std::uint64_t version = 0;  ///< number of the checkpoint; 0: there was none
  std::map<std::string, std::string, std::less<>> entries;
};

/// A task's changes since its last checkpoint.
struct Checkpoint {
  /// The new value of one key.
  struct Change {
    std::string key;
    std::optional<std::string> value;  ///< empty: the key was erased
  };
  std::uint64_t version = 0;  ///< one more than the last
  std::uint64_t entries = 0;  ///< number of keys after the checkpoint
  std::span<const Change> changes;
};

/// Keeps the state of tasks. Keys and values are any bytes. Thread safe, because each task uses its own state only.
class StateStore {
 public:
  virtual ~StateStore() = default;
  /// \throws StateError if the state cannot be read, is incomplete, or was written by another number of tasks.
  virtual StoredState load(const StateOwner& owner) = 0;
  /// Writes all changes or none; they are durable when it returns. \throws StateError: it is then unknown whether they
  /// were written.
  virtual void commit(const StateOwner& owner, const Checkpoint& checkpoint) = 0;
};

/// Opens a store. "memory://NAME" is one in memory that lives as long as the process. "rocksdb:///path" is a database
/// in a folder of its own, which only one process at a time may use. In one process the same URL gives the same store.
/// Thread safe. \throws StateError for any other URL, and if the store cannot be opened.
std::shared_ptr<StateStore> make_state_store(const std::string& url);

}  // namespace iotcloud::topology
