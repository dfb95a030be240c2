#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/reasoned_outcome.h>

namespace iotcloud::master {

/// Watches the workers of a topology in the registry for the outcomes of one order. Used by one thread.
class TopologyWatch {
 public:
  /// \param revision the order's revision. \param kill whether the order is to kill, which workers follow by ending and
  /// not by a report. The references outlive the watch.
  TopologyWatch(discovery::Registry& registry, const discovery::Paths& paths, discovery::TopologyName topology,
                std::int64_t revision, bool kill);
  ~TopologyWatch();
  TopologyWatch(const TopologyWatch&) = delete;
  TopologyWatch& operator=(const TopologyWatch&) = delete;

  /// Adds a worker, by its name.
  void expect(const std::string& worker);

  /// Returns the outcomes by worker when all are known, after `limit`, or when `stop` is requested.
  /// \throws discovery::RegistryError
  std::map<std::string, ReasonedOutcome> wait(std::chrono::milliseconds limit, const std::stop_token& stop);

 private:
  struct Expected {
    bool gone = false;
    std::optional<ReasonedOutcome> outcome;
    std::string last_state;  ///< the state seen last, for the reason of `unknown`
  };
  void on_worker(const std::string& worker, const std::optional<discovery::Node>& node);
  ReasonedOutcome of_gone(const std::string& worker);

  discovery::Registry& registry_;
  const discovery::Paths& paths_;
  const discovery::TopologyName topology_;
  const std::int64_t revision_;
  const bool kill_;

  config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  std::map<std::string, Expected> expected_ IOTCLOUD_GUARDED_BY(mutex_);
  std::vector<discovery::GuardPtr> guards_;  ///< only used by the thread that uses the watch
};

}  // namespace iotcloud::master
