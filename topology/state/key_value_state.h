#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/topology/state/state_store.h>

namespace iotcloud::topology {

namespace internal {

/// How often the keys that a task wrote last had been changed then. It knows the newest `most` / 2 keys at least, and
/// `most` at most.
class LastWrites {
 public:
  explicit LastWrites(std::size_t most) : half_(most / 2) {}
  void set(const std::string& key, std::uint64_t changes);
  std::optional<std::uint64_t> find(const std::string& key) const;
  void forget(const std::string& key);
  std::size_t size() const { return newer_.size() + older_.size(); }

 private:
  using Changes = std::map<std::string, std::uint64_t>;
  const std::size_t half_;
  Changes newer_, older_;  ///< no key is in both; when `newer_` has half_ keys, they take the place of the older ones
};

}  // namespace internal

/// The state of one task: keys and values of any bytes. All of it is in memory; the store has the last checkpoint. Only
/// the task's own calls may use it. References and views are valid until their key changes.
///
/// With a shared store (StateStore::shared()) the keys belong to all tasks of the component in all workers. Memory has
/// those that this task has used since its last checkpoint: the first use of a key claims and reads it. find(), get(),
/// put() and erase() then throw StateUnavailable while the store is away, and change nothing. Views are valid until the
/// next checkpoint, which forgets all keys.
class KeyValueState {
 public:
  /// Loads the store's last checkpoint. \param most_remembered with a shared store: of how many keys at most, the last
  /// that it wrote, the task notices that the store has lost them (take_losses()); it notices it of half as many in any
  /// case. \throws StateError; StateUnavailable.
  KeyValueState(std::shared_ptr<StateStore> store, StateOwner owner, std::size_t most_remembered = 100'000);

  /// The value of a key; nullptr if the key does not exist.
  const std::string* find(std::string_view key) const;
  std::string get(std::string_view key, std::string_view otherwise = "") const;
  /// \throws StateError for a key of another group (expect_group()).
  void put(std::string_view key, std::string value);
  /// \return false if the key did not exist.
  bool erase(std::string_view key);
  /// With a shared store only the keys that this task has used since its last checkpoint; size() counts these.
  const std::map<std::string, std::string, std::less<>>& entries() const { return state_.entries; }
  std::size_t size() const { return state_.entries.size(); }

  // Whole numbers, stored as decimal text. get_int() throws std::invalid_argument if the value is not a number.
  std::int64_t get_int(std::string_view key, std::int64_t otherwise = 0) const;
  void put_int(std::string_view key, std::int64_t value) { put(key, std::to_string(value)); }

  bool shared() const { return shared_; }  ///< StateStore::shared()
  /// How many checkpoints were written since this state was made, by earlier processes too (not with a shared store).
  std::uint64_t version() const { return state_.version; }
  /// Whether checkpoint() has something to write.
  bool changed() const { return !before_.empty() || !unsure_.empty(); }

  /// Writes the changes since the last checkpoint. Without changes it writes nothing, and asks a shared store now and
  /// then whether it is well.
  /// \throws StateError; the state is then rolled back to the last checkpoint. StateUnavailable: the changes are still
  /// there, for the next attempt.
  void checkpoint();
  /// Undoes the changes since the last checkpoint.
  void roll_back();

  /// With a shared store: the changes from here on can be undone by undo_call().
  void begin_call() { before_call_.clear(); }
  /// Undoes the changes since begin_call().
  void undo_call();
  /// From here on put() takes only keys that the tuples of one group use, as far as StateOwner::task_of knows them.
  /// \param group the place of these tuples' task among `groups` tasks; empty: put() takes any key
  void expect_group(std::function<std::size_t()> group) { group_ = std::move(group); }
  static constexpr std::size_t groups = 65536;
  /// Sentences about keys of which the store has lost checkpoints (a failover of Redis), since the last call.
  std::vector<std::string> take_losses() { return std::exchange(losses_, {}); }

 private:
  using Values = std::map<std::string, std::optional<std::string>, std::less<>>;

  void claim(std::string_view key) const;
  void remember(std::string_view key);
  void restore(const Values& values);
  void commit_claimed();
  void forget_claims();

  const std::shared_ptr<StateStore> store_;
  const StateOwner owner_;
  const bool shared_;
  mutable StoredState state_;  ///< find() adds what it has claimed
  /// Values of changed keys at the last checkpoint; nullopt: the key did not exist.
  Values before_;
  std::function<std::size_t()> group_;  ///< of expect_group()
  std::set<std::string> unsure_;        ///< keys of a failed checkpoint, which the store may have written or not

  // With a shared store:
  /// Keys that were claimed since the last checkpoint, with ClaimedValue::changes.
  mutable std::map<std::string, std::uint64_t, std::less<>> claims_;
  /// ClaimedValue::changes of the keys that this task has written, as of then: a claim that brings less shows a loss.
  mutable internal::LastWrites written_;
  mutable std::vector<std::string> losses_;
  Values before_call_;  ///< values of the keys that changed since begin_call(), as they were then
};

}  // namespace iotcloud::topology
