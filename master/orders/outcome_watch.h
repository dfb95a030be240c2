#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/reasoned_outcome.h>

namespace iotcloud::master {

/// The version and state that an update brings an instance to.
struct AwaitedVersion {
  std::string plugin;
  std::string sha256;      ///< empty: any hash but `not_sha256`
  std::string not_sha256;  ///< hash of the previous version; may be empty
  bool active = true;      ///< the ordered state
  bool anew = false;       ///< the state must have been reached after the order was written
};

/// Watches the records of some instances in the registry for the outcomes of one order, all at the same time. Use:
/// write an instance's order and expect() it, for each instance; then wait() for all. Used by one thread.
class OutcomeWatch {
 public:
  /// The state that shows that the order is done. gone: no record, or undeployed. described: the metadata changes are
  /// in the record. anew: active or inactive, reached after the order was written. updated: see AwaitedVersion.
  enum class Wanted { active, inactive, gone, described, anew, updated };

  /// The references outlive the watch.
  OutcomeWatch(discovery::Registry& registry, const discovery::Paths& paths, Wanted wanted);
  /// Waits for records that show these metadata changes, whatever the instances' state.
  OutcomeWatch(discovery::Registry& registry, const discovery::Paths& paths, MetadataChanges changes);
  ~OutcomeWatch();
  OutcomeWatch(const OutcomeWatch&) = delete;
  OutcomeWatch& operator=(const OutcomeWatch&) = delete;

  /// \param driver the name of the driver in the record's path; empty: not known yet, so all drivers are watched.
  /// \param before the record's node as it was before the order: a failure in it is not the order's outcome.
  /// \param version for `updated`.
  /// \throws discovery::RegistryError
  void expect(const discovery::InstanceId& instance, const discovery::DriverName& driver,
              const std::optional<discovery::Node>& before, AwaitedVersion version = {});

  /// Returns when all outcomes are known, after `limit`, or when `stop` is requested; by instance id.
  std::map<discovery::InstanceId, ReasonedOutcome> wait(std::chrono::milliseconds limit, const std::stop_token& stop);

 private:
  struct Expected {
    std::optional<std::pair<std::int64_t, std::int64_t>> before;  ///< created, version
    /// The record's state before the order, and since when; only for `anew`.
    std::optional<std::pair<discovery::DriverState, std::int64_t>> state_before;
    AwaitedVersion version;
    std::optional<ReasonedOutcome> outcome;
    std::string last_state;  ///< the state seen last, for the text of `unknown`
  };
  void watch_record(const discovery::DriverName& driver, const discovery::InstanceId& instance);
  void on_driver_names(const std::vector<std::string>& names);
  void on_record(const std::string& path, const discovery::InstanceId& instance,
                 const std::optional<discovery::Node>& node);
  std::optional<ReasonedOutcome> judge_metadata(Expected& expected, const discovery::DriverRecord& record) const;
  std::optional<ReasonedOutcome> judge(Expected& expected, const std::string& path,
                                       const std::optional<discovery::Node>& node) const;

  discovery::Registry& registry_;
  const discovery::Paths& paths_;
  const Wanted wanted_;
  const MetadataChanges changes_;

  config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  std::map<discovery::InstanceId, Expected> expected_ IOTCLOUD_GUARDED_BY(mutex_);
  std::size_t open_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< number of expectations whose outcome is not known
  std::set<discovery::DriverName> driver_names_ IOTCLOUD_GUARDED_BY(mutex_);  ///< the names of all drivers
  std::set<discovery::InstanceId> anywhere_ IOTCLOUD_GUARDED_BY(mutex_);      ///< instances whose driver is not known
  std::vector<discovery::GuardPtr> record_guards_ IOTCLOUD_GUARDED_BY(mutex_);
  discovery::GuardPtr names_guard_;  ///< only used by the thread that uses the watch
};

}  // namespace iotcloud::master
