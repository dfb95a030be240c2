#include <set>

#include <iotcloud/gateway/fleet/host_metrics.h>
#include <iotcloud/gateway/host/broker_states.h>

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

std::string HostMetrics::brokers_away() const {
  std::set<std::string> away;  // several hosts may use one broker
  {
    const config::MutexLock lock(mutex_);
    for (const auto& [host, told] : hosts_) {
      for (const auto& sample : told.samples) {
        if (sample.name != broker_away_metric || sample.value == 0) continue;
        const auto label = [&](const char* name) {
          const auto found = sample.labels.find(name);
          return found == sample.labels.end() ? std::string() : found->second;
        };
        away.insert("the broker " + label("broker") + " (" + label("url") + ") is away");
      }
    }
  }
  std::string text;
  for (const auto& one : away) text += (text.empty() ? "" : "; ") + one;
  return text;
}

}  // namespace iotcloud::gateway
