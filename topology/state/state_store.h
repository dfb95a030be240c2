#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include <iotcloud/config/error.h>

namespace iotcloud::topology {

/// Says that a store cannot be opened, read or written: which one, why, and how to mend it.
class StateError : public config::Error {
 public:
  using Error::Error;
};

/// A shared store cannot be used now. The state is as it was; try again later. If a commit throws it, the store may
/// have taken the changes or not: commit them again.
class StateUnavailable : public StateError {
 public:
  using StateError::StateError;
};

/// Another task or worker has claimed a key that this task uses. Nothing was written, and what this task has changed
/// since its last checkpoint is void.
class StateClaimed : public StateError {
 public:
  using StateError::StateError;
};

/// The owner of a state. Without a shared store each key is in the state of one task. Another number of tasks can use
/// the state only if `task_of` says which of them uses a key, or if there is one task now: the first of them that loads
/// the state then gives each key to its task.
struct StateOwner {
  /// The place of the task, among `tasks`, that uses a key; nullopt: that is not known.
  using TaskOf = std::function<std::optional<std::size_t>(std::string_view key, std::size_t tasks)>;

  std::string topology;
  std::string component;
  int task_index = 0;
  int task_count = 1;
  std::string session{};  ///< differs for each task of each process; KeyValueState fills it
  TaskOf task_of{};       ///< empty: not known for any key
};

/// A task's state at its last checkpoint.
struct StoredState {
  std::uint64_t version = 0;  ///< number of the checkpoint; 0: there was none
  std::map<std::string, std::string, std::less<>> entries;
};

/// The entry of one key in a shared store.
struct ClaimedValue {
  std::optional<std::string> value;  ///< empty: the key does not exist
  std::uint64_t changes = 0;         ///< number of checkpoints that have changed it
};

/// A task's changes since its last checkpoint.
struct Checkpoint {
  /// The new value of one key.
  struct Change {
    std::string key;
    std::optional<std::string> value;  ///< empty: the key was erased
  };
  /// A key that the task has claimed in a shared store.
  struct Claim {
    std::string key;
    std::uint64_t changes = 0;  ///< ClaimedValue::changes; a change of the key adds one
  };
  std::uint64_t version = 0;  ///< one more than the last
  std::uint64_t entries = 0;  ///< number of keys after the checkpoint
  std::span<const Change> changes;
  /// With a shared store all keys that the task has claimed since its last checkpoint, in order; those of `changes` are
  /// among them. Empty with another store.
  std::span<const Claim> claimed{};
};

/// Keeps the state of tasks. Keys and values are any bytes. Thread safe, because each task uses its own state only.
class StateStore {
 public:
  virtual ~StateStore() = default;
  /// Whether the state belongs to no task: any task of the component, in any worker, may claim any key.
  virtual bool shared() const { return false; }
  /// Reads a task's whole state; a shared store returns nothing, because tasks claim the keys that they use. \throws
  /// StateError if the state cannot be read, is incomplete, or was written by another number of tasks and cannot be
  /// given to these; StateUnavailable.
  virtual StoredState load(const StateOwner& owner) = 0;
  /// For a shared store: reads a key, and makes this task the only one that can write it until another one claims it.
  /// \throws StateUnavailable
  virtual ClaimedValue claim(const StateOwner& /*owner*/, const std::string& /*key*/) { return {}; }
  /// For a shared store: makes sure that it has not lost its data; an answer of the last second is enough. \throws
  /// StateUnavailable
  virtual void make_sure() {}
  /// Writes all changes or none; they are durable when it returns. \throws StateError: it is then unknown whether they
  /// were written, but not if another number of tasks has loaded the state since. A shared store throws StateClaimed or
  /// StateUnavailable.
  virtual void commit(const StateOwner& owner, const Checkpoint& checkpoint) = 0;
};

/// Opens a store. "memory://NAME" is one in memory that lives as long as the process. "rocksdb:///path" is a database
/// in a folder of its own, which only one process at a time may use. "redis://HOST:PORT" and "rediss://..." are a
/// Redis, which all workers of a topology share (README.md). In one process the same URL gives the same store. Thread
/// safe. \throws StateError for any other URL, and if the store cannot be opened.
std::shared_ptr<StateStore> make_state_store(const std::string& url);

namespace internal {

/// A key in quotes, for messages: other bytes than printable ASCII as \xNN, and no more than the first 64.
std::string quoted(std::string_view key);

}  // namespace internal

}  // namespace iotcloud::topology
