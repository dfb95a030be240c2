#include <algorithm>
#include <iterator>
#include <utility>

#include <iotcloud/topology/endpoints/placement/driver_units.h>

namespace iotcloud::topology {

void DriverUnits::declare(const Source& source, const std::string& description) {
  const config::MutexLock lock(mutex_);
  sources_[source].descriptions.insert(description);
}

std::string DriverUnits::description(const Source& source) const {
  const config::MutexLock lock(mutex_);
  const auto found = sources_.find(source);
  if (found == sources_.end() || found->second.descriptions.size() < 2) return {};
  std::string all;
  for (const auto& each : found->second.descriptions) all += (all.empty() ? "" : "; ") + each;
  return all;
}

void DriverUnits::set(const Source& source, const std::string& component, UnitNames names) {
  const config::MutexLock lock(mutex_);
  Spouts& spouts = sources_[source];
  UnitNames& known = spouts.names[component];
  if (known == names) return;
  known = std::move(names);
  for (const auto& [other, on_change] : spouts.listeners) {
    if (other != component) on_change();
  }
}

UnitNames DriverUnits::of(const Source& source) const {
  const config::MutexLock lock(mutex_);
  UnitNames all;
  const auto found = sources_.find(source);
  if (found == sources_.end()) return all;
  for (const auto& [component, names] : found->second.names) {
    all.resize(std::max(all.size(), names.size()));
    for (std::size_t kind = 0; kind < names.size(); ++kind) {
      std::vector<std::string> both;
      std::set_union(all[kind].begin(), all[kind].end(), names[kind].begin(), names[kind].end(),
                     std::back_inserter(both));
      all[kind] = std::move(both);
    }
  }
  return all;
}

void DriverUnits::listen(const Source& source, const std::string& component, std::function<void()> on_change) {
  const config::MutexLock lock(mutex_);
  sources_[source].listeners[component] = std::move(on_change);
}

void DriverUnits::ignore(const Source& source, const std::string& component) {
  const config::MutexLock lock(mutex_);
  sources_[source].listeners.erase(component);
}

}  // namespace iotcloud::topology
