#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology {

/// What one task remembers: keys and values of any bytes, all of it in memory, and in the store as of the last
/// checkpoint. Used by the task's own calls only. References and views last until the key is changed.
class KeyValueState {
 public:
  /// Begins with what the store has. \throws StateError.
  KeyValueState(std::shared_ptr<StateStore> store, StateOwner owner);

  /// nullptr: there is no such key.
  const std::string* find(std::string_view key) const;
  std::string get(std::string_view key, std::string_view otherwise = "") const;
  void put(std::string_view key, std::string value);
  /// \return false: it was not there.
  bool erase(std::string_view key);
  const std::map<std::string, std::string, std::less<>>& entries() const { return state_.entries; }
  std::size_t size() const { return state_.entries.size(); }

  // Whole numbers, as their decimal text. \throws std::invalid_argument when the value is no number.
  std::int64_t get_int(std::string_view key, std::int64_t otherwise = 0) const;
  void put_int(std::string_view key, std::int64_t value) { put(key, std::to_string(value)); }

  /// The number of checkpoints that were written, over all lives of this state.
  std::uint64_t version() const { return state_.version; }
  bool changed() const { return !before_.empty() || !unsure_.empty(); }

  /// Writes the changes since the last checkpoint. Does nothing when there is none.
  /// \throws StateError; then the state is again what it was at the last checkpoint.
  void checkpoint();
  /// Takes back what changed since the last checkpoint.
  void roll_back();

 private:
  void remember(std::string_view key);

  const std::shared_ptr<StateStore> store_;
  const StateOwner owner_;
  StoredState state_;
  std::map<std::string, std::optional<std::string>, std::less<>> before_;  ///< of what changed, as of the checkpoint
  std::set<std::string> unsure_;  ///< keys of a failed checkpoint: the store may have them or not
};

}  // namespace iotcloud::topology
