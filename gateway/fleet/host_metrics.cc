#include <iotcloud/gateway/fleet/host_metrics.h>
#include <iotcloud/gateway/host/round_trips.h>

namespace iotcloud::gateway {

void HostMetrics::put(const std::string& host, int process, std::vector<config::Sample> samples) {
  for (auto& sample : samples) sample.labels["host"] = host;
  const config::MutexLock lock(mutex_);
  hosts_[host] = {process, clock_.now(), std::move(samples)};
}

void HostMetrics::forget(const std::string& host, int process) {
  const config::MutexLock lock(mutex_);
  const auto found = hosts_.find(host);
  if (found != hosts_.end() && found->second.process == process) hosts_.erase(found);
}

void HostMetrics::append(std::vector<config::Sample>& samples) const {
  const config::MutexLock lock(mutex_);
  for (const auto& [host, told] : hosts_) {
    samples.insert(samples.end(), told.samples.begin(), told.samples.end());
    config::Sample age;
    age.name = samples_age_metric;
    age.help = "Age of the samples of a driver host";
    age.labels = {{"host", host}};
    age.kind = config::Sample::Kind::gauge;
    age.value = std::chrono::duration<double>(clock_.now() - told.at).count();
    samples.push_back(std::move(age));
  }
}

}  // namespace iotcloud::gateway
