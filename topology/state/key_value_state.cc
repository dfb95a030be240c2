#include <charconv>
#include <stdexcept>
#include <vector>

#include <iotcloud/topology/state/key_value_state.h>

namespace iotcloud::topology {

KeyValueState::KeyValueState(std::shared_ptr<StateStore> store, StateOwner owner)
    : store_(std::move(store)), owner_(std::move(owner)), state_(store_->load(owner_)) {}

const std::string* KeyValueState::find(std::string_view key) const {
  const auto found = state_.entries.find(key);
  return found == state_.entries.end() ? nullptr : &found->second;
}

std::string KeyValueState::get(std::string_view key, std::string_view otherwise) const {
  const std::string* value = find(key);
  return value != nullptr ? *value : std::string(otherwise);
}

void KeyValueState::put(std::string_view key, std::string value) {
  remember(key);
  const auto found = state_.entries.find(key);
  if (found != state_.entries.end()) {
    found->second = std::move(value);
  } else {
    state_.entries.emplace(key, std::move(value));
  }
}

bool KeyValueState::erase(std::string_view key) {
  const auto found = state_.entries.find(key);
  if (found == state_.entries.end()) return false;
  remember(key);
  state_.entries.erase(found);
  return true;
}

std::int64_t KeyValueState::get_int(std::string_view key, std::int64_t otherwise) const {
  const std::string* value = find(key);
  if (value == nullptr) return otherwise;
  std::int64_t number = 0;
  const auto [end, status] = std::from_chars(value->data(), value->data() + value->size(), number);
  if (status != std::errc{} || end != value->data() + value->size()) {
    throw std::invalid_argument("the state of \"" + std::string(key) + "\" is no whole number: \"" + *value + "\"");
  }
  return number;
}

void KeyValueState::remember(std::string_view key) {
  if (before_.find(key) != before_.end()) return;
  const std::string* value = find(key);
  before_.emplace(key, value != nullptr ? std::optional(*value) : std::nullopt);
}

void KeyValueState::checkpoint() {
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
  for (auto& [key, value] : before_) {
    if (value) {
      state_.entries[key] = std::move(*value);
    } else {
      state_.entries.erase(key);
    }
  }
  before_.clear();
}

}  // namespace iotcloud::topology
