#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
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

class ChangeFile;

/// The latest changes of state of all instances of a gateway, of those that are gone too. Thread safe.
class ChangeLog {
 public:
  /// \param file where they outlive the gateway, see ChangeFile; empty: they do not.
  explicit ChangeLog(std::size_t most, const std::string& file = "");
  ~ChangeLog();

  /// What an earlier life told of the instance at last is not told again: so it is with one that was adopted.
  void add(StateChange change);
  /// Of the instance, or of all when it is empty; the oldest first.
  std::vector<StateChange> of(const std::string& instance) const;

 private:
  const std::size_t most_;
  mutable std::mutex mutex_;
  std::deque<StateChange> changes_;                  ///< guarded by mutex_
  std::map<std::string, StateChange> earlier_life_;  ///< guarded by mutex_; the last of each instance not seen since
  std::unique_ptr<ChangeFile> file_;                 ///< guarded by mutex_; null: none
};

}  // namespace iotcloud::gateway
