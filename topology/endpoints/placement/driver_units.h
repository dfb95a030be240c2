#pragma once

#include <functional>
#include <map>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/ids.h>

namespace iotcloud::topology {

/// Names of units of placement, for each UnitKind in order of the alphabet.
using UnitNames = std::vector<std::vector<std::string>>;

/// The units of a driver that the spouts of one worker have, all spouts together. Who shares out a spout's units among
/// workers shares out all of the driver's: otherwise a driver instance that lacks one of the channels would change the
/// shares of that channel only, and the channels of other instances would be read in different workers. One object for
/// each worker. Thread safe.
class DriverUnits {
 public:
  /// A driver, as a group of readers sees it.
  struct Source {
    std::string group;
    discovery::DriverName driver;
    friend bool operator<(const Source& a, const Source& b) {
      return std::tie(a.group, a.driver) < std::tie(b.group, b.driver);
    }
  };

  /// The topology has a spout that reads this source. To be called for all of them before the first set().
  /// \param description of what decides about the spout's units and shares: channel, number of tasks, choice of drivers
  void declare(const Source& source, const std::string& description) IOTCLOUD_EXCLUDES(mutex_);
  /// All descriptions; empty if there is only one spout. Workers with the same text have the same units in the end.
  std::string description(const Source& source) const IOTCLOUD_EXCLUDES(mutex_);

  /// The units of one spout. Calls the listeners of the source's other spouts if they are not the same as before.
  void set(const Source& source, const std::string& component, UnitNames names) IOTCLOUD_EXCLUDES(mutex_);
  /// The units of all spouts.
  UnitNames of(const Source& source) const IOTCLOUD_EXCLUDES(mutex_);

  /// set() calls `on_change` with a lock held: it must not call this object. One listener for each spout.
  void listen(const Source& source, const std::string& component, std::function<void()> on_change)
      IOTCLOUD_EXCLUDES(mutex_);
  /// Removes that listener, which does not run any more then. The spout's units stay: other spouts share theirs out as
  /// the other workers do until they end, too.
  void ignore(const Source& source, const std::string& component) IOTCLOUD_EXCLUDES(mutex_);

 private:
  struct Spouts {
    std::multiset<std::string> descriptions;
    std::map<std::string, UnitNames> names;                  ///< by component
    std::map<std::string, std::function<void()>> listeners;  ///< by component
  };

  mutable config::Mutex mutex_;
  std::map<Source, Spouts> sources_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology
