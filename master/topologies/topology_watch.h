#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/master/orders/orders.h>

namespace iotcloud::master {

/// Reads from the registry what becomes of one order in the workers of a topology. Used by one thread.
class TopologyWatch {
 public:
  /// \param revision the order's. \param kill the workers are to end, not to report it. The references outlive the
  /// watch.
  TopologyWatch(discovery::Registry& registry, const discovery::Paths& paths, std::string topology,
                std::int64_t revision, bool kill);
  ~TopologyWatch();
  TopologyWatch(const TopologyWatch&) = delete;
  TopologyWatch& operator=(const TopologyWatch&) = delete;

  /// Adds a worker, by its name.
  void expect(const std::string& worker);

  struct Verdict {
    Outcome outcome = Outcome::unknown;
    std::string reason;
  };
  /// Returns when all outcomes are known, after `limit`, or when `stop` is requested; by worker.
  /// \throws discovery::RegistryError
  std::map<std::string, Verdict> wait(std::chrono::milliseconds limit, const std::stop_token& stop);

 private:
  struct Expected {
    bool gone = false;
    std::optional<Verdict> verdict;
    std::string last_state;  ///< for the text of `unknown`
  };
  void on_worker(const std::string& worker, const std::optional<discovery::Node>& node);
  Verdict of_gone(const std::string& worker);

  discovery::Registry& registry_;
  const discovery::Paths& paths_;
  const std::string topology_;
  const std::int64_t revision_;
  const bool kill_;

  std::mutex mutex_;
  std::condition_variable_any changed_;
  std::map<std::string, Expected> expected_;  ///< guarded by mutex_
  std::vector<discovery::GuardPtr> guards_;   ///< of the one thread that uses the watch
};

}  // namespace iotcloud::master
