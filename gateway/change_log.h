#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/records.h>

namespace iotcloud::gateway {

/// One change of state of one driver instance.
struct StateChange {
  discovery::InstanceId instance;
  discovery::DriverName driver;
  discovery::DriverState state = discovery::DriverState::deployed;
  std::string reason;        ///< for people
  std::int64_t time_ms = 0;  ///< wall time
  static constexpr const char* what = "a change of state";
  static constexpr auto fields =
      std::tuple{IOTCLOUD_FIELD_AS(time_ms, required, "time_ms", timeMs), IOTCLOUD_FIELD(instance, required),
                 IOTCLOUD_FIELD(driver, required), IOTCLOUD_FIELD(state, required), IOTCLOUD_FIELD(reason, required)};
  friend bool operator==(const StateChange&, const StateChange&) = default;
};

/// The latest of these changes, of which the last one is the latest, that an answer of so many bytes has room for: the
/// reasons are as long as drivers make them.
std::vector<StateChange> latest_of(std::vector<StateChange> changes, std::size_t most_bytes);

class ChangeFile;

/// The latest changes of state of all instances of a gateway, undeployed ones included. Thread safe.
class ChangeLog {
 public:
  /// \param file keeps the changes across restarts, see ChangeFile; empty: they are kept in memory only. \param most
  /// how many changes are kept.
  explicit ChangeLog(std::size_t most, const std::string& file = "");
  ~ChangeLog();

  /// Adds a change. An adopted instance reports its state again: the first change of an instance in this run is ignored
  /// if it equals the last one of the earlier run.
  void add(const StateChange& change);
  /// Waits until the file's changes are on the disk. The gateway calls it about once a second.
  void sync();
  /// The changes of this instance, or of all instances if the id is empty; the oldest first.
  std::vector<StateChange> of(const discovery::InstanceId& instance) const;

 private:
  const std::size_t most_;
  /// Held while the file is written, which may take long on a slow disk. A thread locks it before mutex_, so that the
  /// file gets the changes in the order of changes_.
  config::Mutex file_mutex_ IOTCLOUD_ACQUIRED_BEFORE(mutex_);
  std::unique_ptr<ChangeFile> file_ IOTCLOUD_GUARDED_BY(file_mutex_);  ///< null: changes are kept in memory only
  mutable config::Mutex mutex_;
  std::deque<StateChange> changes_ IOTCLOUD_GUARDED_BY(mutex_);
  /// The last change that the earlier run recorded for each instance, until this run adds one for the instance.
  std::map<discovery::InstanceId, StateChange> earlier_life_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::gateway
