#pragma once

#include <map>
#include <mutex>
#include <string>
#include <vector>

#include <iotcloud/config/metrics.h>

namespace iotcloud::gateway {

/// What the metrics of driver host processes say, as their links collect it, for the page of the gateway: a host serves
/// none of its own. Each sample has its host's name in the label `host`. Thread safe.
class HostMetrics {
 public:
  /// \param process tells hosts of one name apart: of two the one that spoke last is shown.
  void put(const std::string& host, int process, std::vector<config::Sample> samples);
  /// The host has ended.
  void forget(const std::string& host, int process);
  /// A config::Metrics::Source.
  void append(std::vector<config::Sample>& samples) const;

 private:
  struct Told {
    int process = 0;
    std::vector<config::Sample> samples;
  };
  mutable std::mutex mutex_;
  std::map<std::string, Told> hosts_;  ///< guarded by mutex_
};

}  // namespace iotcloud::gateway
