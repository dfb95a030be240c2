#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <string>
#include <vector>

#include <iotcloud/discovery/records.h>

namespace iotcloud::gateway {

/// One change of state of one driver instance.
struct StateChange {
  std::string instance;
  std::string driver;
  discovery::DriverState state = discovery::DriverState::deployed;
  std::string reason;        ///< for people
  std::int64_t time_ms = 0;  ///< wall time
  friend bool operator==(const StateChange&, const StateChange&) = default;
};

/// The latest changes of state of all instances of a gateway, of those that are gone too. Thread safe.
class ChangeLog {
 public:
  explicit ChangeLog(std::size_t most) : most_(most) {}

  void add(StateChange change);
  /// Of the instance, or of all when it is empty; the oldest first.
  std::vector<StateChange> of(const std::string& instance) const;

 private:
  const std::size_t most_;
  mutable std::mutex mutex_;
  std::deque<StateChange> changes_;  ///< guarded by mutex_
};

}  // namespace iotcloud::gateway
