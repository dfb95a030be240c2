#pragma once

#include <chrono>
#include <cstddef>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::master {

/// Lists all driver instances. When they are few, each list() reads all records. When they are many, the view watches
/// their nodes from the first list() on, so that it reads only changed records again. A change that this master did not
/// order may then show some milliseconds late. Thread safe; one list() runs at a time.
class DriverView {
 public:
  struct Options {
    std::size_t few = 256;  ///< up to this number of instances each list() reads all records
    /// How long list() waits for watches of new instances before it reads those that have not reported.
    std::chrono::milliseconds watches_limit{1'000};
  };
  /// The references outlive the view.
  DriverView(discovery::Registry& registry, const discovery::Paths& paths, Options options);
  DriverView(discovery::Registry& registry, const discovery::Paths& paths) : DriverView(registry, paths, Options()) {}
  ~DriverView();
  DriverView(const DriverView&) = delete;
  DriverView& operator=(const DriverView&) = delete;

  /// Returns the records with their channels. \throws discovery::RegistryError.
  std::vector<discovery::DriverRecord> list();
  /// An order for this instance has an outcome: the next list() reads the record anew.
  void ordered(const discovery::InstanceId& instance);

 private:
  struct Entry {
    bool read = false;
    std::int64_t created = 0, version = -1;
    std::optional<discovery::DriverRecord> record;
    discovery::GuardPtr watch;  ///< only used by the listing thread
  };
  void watch_all(const std::vector<std::string>& instances) IOTCLOUD_REQUIRES(listing_) IOTCLOUD_EXCLUDES(mutex_);
  void read_ordered(const std::vector<std::string>& instances) IOTCLOUD_REQUIRES(listing_) IOTCLOUD_EXCLUDES(mutex_);
  void wait_until_read() IOTCLOUD_EXCLUDES(mutex_);
  void take(const std::string& path, const std::optional<discovery::Node>& node) IOTCLOUD_EXCLUDES(mutex_);
  void forget(std::map<std::string, Entry> gone) IOTCLOUD_EXCLUDES(mutex_);

  discovery::Registry& registry_;
  const discovery::Paths& paths_;
  const Options options_;
  /// Held during list(), also while it reads the registry, so that one runs at a time. No callback locks it.
  config::Mutex listing_ IOTCLOUD_ACQUIRED_BEFORE(mutex_);

  config::Mutex mutex_;
  config::ConditionVariable all_read_;
  std::map<std::string, Entry> entries_ IOTCLOUD_GUARDED_BY(mutex_);  ///< by path
  std::size_t unread_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  std::set<discovery::InstanceId> ordered_
      IOTCLOUD_GUARDED_BY(mutex_);  ///< instances whose records the next list() reads
};

}  // namespace iotcloud::master
