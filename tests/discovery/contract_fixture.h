#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>

#include <iotcloud/discovery/registry.h>
#include <iotcloud/tests/discovery/place.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::discovery::tests {

using iotcloud::tests::patience;

/// Collects the values that callbacks report, in order, and lets a test wait for them. Thread safe.
template <typename Value>
class Seen {
 public:
  void add(Value value) {
    const std::lock_guard lock(mutex_);
    values_.push_back(std::move(value));
    changed_.notify_all();
  }
  std::vector<Value> all() const {
    const std::lock_guard lock(mutex_);
    return values_;
  }
  /// Waits until `condition` returns true for the values that were collected so far.
  [[nodiscard]] bool wait(const std::function<bool(const std::vector<Value>&)>& condition) const {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, patience, [&] { return condition(values_); });
  }
  [[nodiscard]] bool wait_for_last(const Value& value) const {
    return wait([&](const auto& values) { return !values.empty() && values.back() == value; });
  }
  [[nodiscard]] bool wait_for_count(std::size_t count) const {
    return wait([&](const auto& values) { return values.size() >= count; });
  }

 private:
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  std::vector<Value> values_;
};

/// A watched node's data, or "(none)".
inline std::string text(const std::optional<Node>& node) {
  return node ? node->data : "(none)";
}
/// A watched list of children: "a b c", or "(none)".
inline std::string text(const std::optional<std::vector<std::string>>& names) {
  if (!names) return "(none)";
  std::string all;
  for (const std::string& name : *names) all += (all.empty() ? "" : " ") + name;
  return all;
}

using iotcloud::tests::eventually;

class RegistryContract : public testing::TestWithParam<std::string> {
 protected:
  /// Makes one more client of the same tree.
  std::unique_ptr<Registry> client(std::chrono::milliseconds session_timeout = std::chrono::seconds(20)) const {
    RegistryOptions options;
    options.url = place_->url();
    options.session_timeout = session_timeout;
    options.operation_timeout = patience;
    return make_registry(options);
  }

  static std::int64_t session_of(Registry& registry) {
    const auto guard = registry.hold("/who-am-i", "");
    return registry.get("/who-am-i")->owner_session;
  }

  /// The code of the error that `action` throws, or nothing.
  static std::optional<RegistryErrorCode> code_of(const std::function<void()>& action) {
    try {
      action();
    } catch (const RegistryError& error) {
      return error.code();
    }
    return std::nullopt;
  }

  const std::unique_ptr<Place> place_ = make_place(GetParam());
  const std::unique_ptr<Registry> registry_ = client();
  const std::unique_ptr<Registry> other_ = client();
};

}  // namespace iotcloud::discovery::tests
