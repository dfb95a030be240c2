#pragma once

#include <map>
#include <string>
#include <vector>

#include <iotcloud/config/clock.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::gateway {

/// The latest metrics of the driver host processes. Their links collect them for the gateway's metrics page, because a
/// host serves no page of its own. Each sample has its host's name in the label `host`. Thread safe.
class HostMetrics {
 public:
  /// \param clock outlives this
  explicit HostMetrics(const config::Clock& clock = config::system_clock()) : clock_(clock) {}

  /// \param process the host's process id. Of two hosts with the same name, the samples of the one that called last are
  /// shown.
  void put(const std::string& host, int process, std::vector<config::Sample> samples);
  /// Removes the samples of a host that has ended.
  void forget(const std::string& host, int process);
  /// Appends all samples, and for each host the age of its own; usable as a config::Metrics::Source.
  void append(std::vector<config::Sample>& samples) const;

 private:
  struct Told {
    int process = 0;
    config::Clock::Instant at{};
    std::vector<config::Sample> samples;
  };
  const config::Clock& clock_;
  mutable config::Mutex mutex_;
  std::map<std::string, Told> hosts_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::gateway
