#include <random>
#include <stdexcept>
#include <vector>

#include <iotcloud/config/number.h>
#include <iotcloud/topology/state/key_value_state.h>

namespace iotcloud::topology {

namespace {

/// 128 random bits as text.
std::string new_session() {
  std::random_device random;
  std::string text;
  for (int i = 0; i < 4; ++i) text += std::to_string(random()) + (i < 3 ? "-" : "");
  return text;
}

StateOwner with_session(StateOwner owner) {
  if (owner.session.empty()) owner.session = new_session();
  return owner;
}

}  // namespace

namespace internal {

void LastWrites::set(const std::string& key, std::uint64_t changes) {
  older_.erase(key);
  newer_.insert_or_assign(key, changes);
  if (newer_.size() >= half_) older_ = std::exchange(newer_, {});
}

std::optional<std::uint64_t> LastWrites::find(const std::string& key) const {
  for (const Changes* changes : {&newer_, &older_}) {
    if (const auto found = changes->find(key); found != changes->end()) return found->second;
  }
  return std::nullopt;
}

void LastWrites::forget(const std::string& key) {
  newer_.erase(key);
  older_.erase(key);
}

}  // namespace internal

KeyValueState::KeyValueState(std::shared_ptr<StateStore> store, StateOwner owner, std::size_t most_remembered)
    : store_(std::move(store)),
      owner_(with_session(std::move(owner))),
      shared_(store_->shared()),
      state_(store_->load(owner_)),
      written_(most_remembered) {}

const std::string* KeyValueState::find(std::string_view key) const {
  if (shared_) claim(key);
  const auto found = state_.entries.find(key);
  return found == state_.entries.end() ? nullptr : &found->second;
}

std::string KeyValueState::get(std::string_view key, std::string_view otherwise) const {
  const std::string* value = find(key);
  return value != nullptr ? *value : std::string(otherwise);
}

/// Claims and reads the key, unless that was done since the last checkpoint.
void KeyValueState::claim(std::string_view key) const {
  if (claims_.find(key) != claims_.end()) return;
  std::string name(key);
  ClaimedValue claimed = store_->claim(owner_, name);
  if (const auto own = written_.find(name); own && *own > claimed.changes) {
    losses_.push_back("the store has lost " + std::to_string(*own - claimed.changes) + " checkpoints of the key " +
                      internal::quoted(name) + " of component \"" + owner_.component +
                      "\": it is as it was before them, and their messages were acknowledged. Did Redis fail over to a "
                      "replica, or start without its data?");
    written_.forget(name);
  }
  if (claimed.value) state_.entries.insert_or_assign(name, std::move(*claimed.value));
  claims_.emplace(std::move(name), claimed.changes);
}

void KeyValueState::put(std::string_view key, std::string value) {
  if (group_ && owner_.task_of) {
    if (const auto own = owner_.task_of(key, groups); own && *own != group_()) {
      throw StateError("component \"" + owner_.component + "\" puts the key " + internal::quoted(key) +
                       " for a tuple of another key: state.keys or StatefulBolt::grouping_key says that the key "
                       "belongs to other tuples. Correct that, or take it away and keep the number of tasks");
    }
  }
  remember(key);
  const auto found = state_.entries.find(key);
  if (found != state_.entries.end()) {
    found->second = std::move(value);
  } else {
    state_.entries.emplace(key, std::move(value));
  }
}

bool KeyValueState::erase(std::string_view key) {
  if (shared_) claim(key);
  const auto found = state_.entries.find(key);
  if (found == state_.entries.end()) return false;
  remember(key);
  state_.entries.erase(found);
  return true;
}

std::int64_t KeyValueState::get_int(std::string_view key, std::int64_t otherwise) const {
  const std::string* value = find(key);
  if (value == nullptr) return otherwise;
  const auto number = config::parse_number<std::int64_t>(*value);
  if (!number) {
    throw std::invalid_argument("the state of \"" + std::string(key) + "\" is no whole number: \"" + *value + "\"");
  }
  return *number;
}

void KeyValueState::remember(std::string_view key) {
  const std::string* value = find(key);
  const auto add_to = [&](Values& values) {
    if (values.find(key) != values.end()) return;
    values.emplace(key, value != nullptr ? std::optional(*value) : std::nullopt);
  };
  add_to(before_);
  if (shared_) add_to(before_call_);
}

void KeyValueState::commit_claimed() {
  std::vector<Checkpoint::Claim> claimed;
  for (const auto& [key, changes] : claims_) claimed.push_back({key, changes});
  std::vector<Checkpoint::Change> changes;
  for (const auto& [key, value] : before_) {
    const auto now = state_.entries.find(key);
    changes.push_back({key, now == state_.entries.end() ? std::nullopt : std::optional(now->second)});
  }
  try {
    store_->commit(owner_, Checkpoint{state_.version + 1, state_.entries.size(), changes, claimed});
  } catch (const StateUnavailable&) {
    throw;
  } catch (...) {
    forget_claims();
    throw;
  }
  ++state_.version;
  for (const auto& [key, value] : changes) {
    if (value) {
      written_.set(key, claims_.at(key) + 1);
    } else {
      written_.forget(key);  // the store forgets a key without a value after a while
    }
  }
}

/// From here on each key is claimed and read again: another task or worker may use it meanwhile.
void KeyValueState::forget_claims() {
  claims_.clear();
  state_.entries.clear();
  before_.clear();
  before_call_.clear();
}

void KeyValueState::undo_call() {
  restore(std::exchange(before_call_, {}));
}

void KeyValueState::restore(const Values& values) {
  for (const auto& [key, value] : values) {
    if (value) {
      state_.entries[key] = *value;
    } else {
      state_.entries.erase(key);
    }
  }
}

void KeyValueState::checkpoint() {
  if (shared_) {
    if (changed()) {
      commit_claimed();
    } else {
      store_->make_sure();
    }
    return forget_claims();
  }
  if (!changed()) return;
  std::set<std::string> keys = unsure_;
  for (const auto& [key, value] : before_) keys.insert(key);
  std::vector<Checkpoint::Change> changes;
  for (const std::string& key : keys) {
    const std::string* value = find(key);
    changes.push_back({key, value != nullptr ? std::optional(*value) : std::nullopt});
  }
  try {
    store_->commit(owner_, Checkpoint{state_.version + 1, state_.entries.size(), changes});
  } catch (...) {
    unsure_ = std::move(keys);
    roll_back();
    throw;
  }
  ++state_.version;
  before_.clear();
  unsure_.clear();
}

void KeyValueState::roll_back() {
  if (shared_) return forget_claims();
  restore(std::exchange(before_, {}));
}

}  // namespace iotcloud::topology
