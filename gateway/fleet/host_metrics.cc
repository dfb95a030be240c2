#include <iotcloud/gateway/fleet/host_metrics.h>

namespace iotcloud::gateway {

void HostMetrics::put(const std::string& host, int process, std::vector<config::Sample> samples) {
  for (auto& sample : samples) sample.labels["host"] = host;
  const config::MutexLock lock(mutex_);
  hosts_[host] = {process, std::move(samples)};
}

void HostMetrics::forget(const std::string& host, int process) {
  const config::MutexLock lock(mutex_);
  const auto found = hosts_.find(host);
  if (found != hosts_.end() && found->second.process == process) hosts_.erase(found);
}

void HostMetrics::append(std::vector<config::Sample>& samples) const {
  const config::MutexLock lock(mutex_);
  for (const auto& [host, told] : hosts_) samples.insert(samples.end(), told.samples.begin(), told.samples.end());
}

}  // namespace iotcloud::gateway
