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

/// The state of one task: keys and values of any bytes. All of it is in memory; the store has the last checkpoint. Only
/// the task's own calls may use it. References and views are valid until their key changes.
class KeyValueState {
 public:
  /// Loads the store's last checkpoint. \throws StateError.
  KeyValueState(std::shared_ptr<StateStore> store, StateOwner owner);

  /// The value of a key; nullptr if the key does not exist.
  const std::string* find(std::string_view key) const;
  std::string get(std::string_view key, std::string_view otherwise = "") const;
  void put(std::string_view key, std::string value);
  /// \return false if the key did not exist.
  bool erase(std::string_view key);
  const std::map<std::string, std::string, std::less<>>& entries() const { return state_.entries; }
  std::size_t size() const { return state_.entries.size(); }

  // Whole numbers, stored as decimal text. get_int() throws std::invalid_argument if the value is not a number.
  std::int64_t get_int(std::string_view key, std::int64_t otherwise = 0) const;
  void put_int(std::string_view key, std::int64_t value) { put(key, std::to_string(value)); }

  /// How many checkpoints were written since this state was made, by earlier processes too.
  std::uint64_t version() const { return state_.version; }
  /// Whether checkpoint() has something to write.
  bool changed() const { return !before_.empty() || !unsure_.empty(); }

  /// Writes the changes since the last checkpoint; without changes it does nothing.
  /// \throws StateError; the state is then rolled back to the last checkpoint.
  void checkpoint();
  /// Undoes the changes since the last checkpoint.
  void roll_back();

 private:
  void remember(std::string_view key);

  const std::shared_ptr<StateStore> store_;
  const StateOwner owner_;
  StoredState state_;
  /// Values of changed keys at the last checkpoint; nullopt: the key did not exist.
  std::map<std::string, std::optional<std::string>, std::less<>> before_;
  std::set<std::string> unsure_;  ///< keys of a failed checkpoint, which the store may have written or not
};

}  // namespace iotcloud::topology
