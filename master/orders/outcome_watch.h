#pragma once

#include <chrono>
#include <condition_variable>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// What an instance runs when an update has come to it.
struct AwaitedVersion {
  std::string plugin;
  std::string sha256;      ///< empty: any other than `not_sha256`
  std::string not_sha256;  ///< of the version before; may be empty
  bool active = true;      ///< or inactive, as ordered
};

/// Reads from the registry what becomes of one order for some instances, all at the same time.
/// Use: write an instance's order, expect() it, and at last wait() for all. Used by one thread.
class OutcomeWatch {
 public:
  /// anew: active or inactive, reached after the order was written. updated: see AwaitedVersion.
  enum class Wanted { active, inactive, gone, described, anew, updated };

  /// The references outlive the watch.
  OutcomeWatch(discovery::Registry& registry, const discovery::Paths& paths, Wanted wanted);
  /// Wants records that show these changes, whatever the instances' state.
  OutcomeWatch(discovery::Registry& registry, const discovery::Paths& paths, MetadataChanges changes);
  ~OutcomeWatch();
  OutcomeWatch(const OutcomeWatch&) = delete;
  OutcomeWatch& operator=(const OutcomeWatch&) = delete;

  /// \param driver the name that its record stands under; empty: not known yet, so all drivers are watched.
  /// \param before the record's node before the order: a failure that stands there already is not the order's.
  /// \param version for `updated`.
  /// \throws discovery::RegistryError
  void expect(const std::string& instance, const std::string& driver, const std::optional<discovery::Node>& before,
              AwaitedVersion version = {});

  struct Verdict {
    Outcome outcome = Outcome::unknown;
    std::string reason;
  };
  /// Returns when all outcomes are known, after `limit`, or when `stop` is requested; by instance id.
  std::map<std::string, Verdict> wait(std::chrono::milliseconds limit, const std::stop_token& stop);

 private:
  struct Expected {
    std::optional<std::pair<std::int64_t, std::int64_t>> before;  ///< created, version
    /// What the record said before, and since when; with `anew` only.
    std::optional<std::pair<discovery::DriverState, std::int64_t>> state_before;
    AwaitedVersion version;
    std::optional<Verdict> verdict;
    std::string last_state;  ///< what was seen last, for the text of `unknown`
  };
  void watch_record(const std::string& driver, const std::string& instance);
  void on_driver_names(const std::vector<std::string>& names);
  void on_record(const std::string& path, const std::string& instance, const std::optional<discovery::Node>& node);
  std::optional<Verdict> judge_metadata(Expected& expected, const discovery::DriverRecord& record) const;
  std::optional<Verdict> judge(Expected& expected, const std::string& path,
                               const std::optional<discovery::Node>& node) const;
  std::string silence(const Expected& expected, std::chrono::milliseconds limit, bool stopped) const;

  discovery::Registry& registry_;
  const discovery::Paths& paths_;
  const Wanted wanted_;
  const MetadataChanges changes_;

  std::mutex mutex_;
  std::condition_variable_any changed_;
  std::map<std::string, Expected> expected_;        ///< guarded by mutex_
  std::size_t open_ = 0;                            ///< guarded by mutex_: expectations without a verdict
  std::set<std::string> driver_names_;              ///< guarded by mutex_: all there are
  std::set<std::string> anywhere_;                  ///< guarded by mutex_: instances whose driver is not known
  std::vector<discovery::GuardPtr> record_guards_;  ///< guarded by mutex_
  discovery::GuardPtr names_guard_;                 ///< of the one thread that uses the watch
};

}  // namespace iotcloud::master
