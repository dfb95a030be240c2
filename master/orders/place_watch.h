#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <map>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/submissions.h>

namespace iotcloud::master {

/// Watches in the records of all pools what becomes of a topology's worker places. Used by one thread.
class PlaceWatch {
 public:
  /// By place's number. If two pools name one, as while it moves, the one that changed last.
  using Places = std::map<int, discovery::PlaceStatus>;
  /// The references outlive the watch.
  PlaceWatch(discovery::Registry& registry, const discovery::Paths& paths, discovery::TopologyName topology);
  ~PlaceWatch();
  PlaceWatch(const PlaceWatch&) = delete;
  PlaceWatch& operator=(const PlaceWatch&) = delete;

  /// Returns what is seen as soon as all records have been read and `enough` says so, after `limit`, or when `stop` is
  /// requested.
  Places wait(std::chrono::milliseconds limit, const std::stop_token& stop,
              const std::function<bool(const Places&)>& enough);

 private:
  void on_pools(const std::optional<std::vector<std::string>>& names);
  void on_pool(const std::string& name, const std::optional<discovery::Node>& node);
  Places seen() const IOTCLOUD_REQUIRES(mutex_);

  discovery::Registry& registry_;
  const discovery::Paths& paths_;
  const discovery::TopologyName topology_;

  config::Mutex mutex_;
  config::StoppableConditionVariable changed_;
  std::map<std::string, std::vector<discovery::PlaceStatus>> pools_ IOTCLOUD_GUARDED_BY(mutex_);
  std::optional<std::size_t> listed_ IOTCLOUD_GUARDED_BY(mutex_);  ///< how many pools there are; nullopt: not known yet
  std::map<std::string, discovery::GuardPtr> guards_;  ///< used on the registry's dispatcher, until names_ is gone
  discovery::GuardPtr names_;
};

}  // namespace iotcloud::master
