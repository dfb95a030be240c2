#include <iotcloud/topology/endpoints/receiving/held_messages.h>

namespace iotcloud::topology {

void HeldMessages::set_limit(const std::string& component, const std::string& text) {
  const config::MutexLock lock(mutex_);
  if (text.empty()) {
    limits_.erase(component);
  } else {
    limits_[component] = text;
  }
}

std::string HeldMessages::limits() const {
  const config::MutexLock lock(mutex_);
  std::string all;
  for (const auto& [component, text] : limits_) all += (all.empty() ? "" : "; ") + component + ": " + text;
  return all;
}

}  // namespace iotcloud::topology
