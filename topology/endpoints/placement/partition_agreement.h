#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <tuple>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/ids.h>

namespace iotcloud::topology {

/// Whether the channels of a driver instance that some spouts of a worker read are shared out among workers in the same
/// way: all exclusive, or all shared and their topics split into equally many partitions (one, if the broker splits
/// none). If they are not, the instance's messages on two channels are in units of different names, which different
/// workers may have, and would not meet in one worker. Instances of one driver may have topics of their own, on another
/// broker for example, so each is judged alone. The spouts whose tuples can come to one bolt have one object
/// (worker/meeting_spouts.h). Thread safe.
class PartitionAgreement {
 public:
  /// An instance of a driver on a gateway, as a group of readers sees it.
  struct Source {
    std::string group;
    discovery::DriverName driver;
    discovery::GatewayId gateway;
    discovery::InstanceId instance;
    friend bool operator<(const Source& a, const Source& b) {
      return std::tie(a.group, a.driver, a.gateway, a.instance) < std::tie(b.group, b.driver, b.gateway, b.instance);
    }
  };
  /// What decides about a channel's units.
  struct Layout {
    bool exclusive = false;         ///< the instance has the topic to itself
    std::optional<int> partitions;  ///< of a shared channel's topic; nullopt: its broker splits none
    friend bool operator==(const Layout&, const Layout&) = default;
  };

  /// Says how a channel is laid out. Calls all listeners if difference() changes.
  void set(const Source& source, const std::string& channel, const Layout& layout) IOTCLOUD_EXCLUDES(mutex_);
  /// The channel is not read any more. Calls all listeners if difference() changes.
  void forget(const Source& source, const std::string& channel) IOTCLOUD_EXCLUDES(mutex_);
  /// In what the channels differ, and how to mend it; empty: they agree.
  std::string difference(const Source& source) const IOTCLOUD_EXCLUDES(mutex_);

  /// Adds a listener, which set() and forget() call with a lock held: it must not call this object. \return a number
  /// for ignore()
  int listen(std::function<void()> on_change) IOTCLOUD_EXCLUDES(mutex_);
  /// Removes a listener, which does not run any more then.
  void ignore(int listener) IOTCLOUD_EXCLUDES(mutex_);

 private:
  void change(const Source& source, const std::string& channel, const std::optional<Layout>& layout)
      IOTCLOUD_EXCLUDES(mutex_);
  std::string difference_of(const Source& source) const IOTCLOUD_REQUIRES(mutex_);

  mutable config::Mutex mutex_;
  std::map<Source, std::map<std::string, Layout>> layouts_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by source and channel
  int last_listener_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::map<int, std::function<void()>> listeners_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::topology
