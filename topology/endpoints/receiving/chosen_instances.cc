#include <utility>

#include <iotcloud/topology/endpoints/receiving/chosen_instances.h>

namespace iotcloud::topology {

void ChosenInstances::told(const discovery::InstanceId& instance, std::optional<bool> chosen) {
  const config::WriteLock lock(mutex_);
  if (chosen) {
    choices_[instance] = {*chosen, false};
    return;
  }
  const auto found = choices_.find(instance);
  if (found == choices_.end() || std::exchange(found->second.departed, true)) return;
  departed_.push_back(instance);
  if (departed_.size() <= most_departed) return;
  const auto oldest = choices_.find(departed_.front());
  if (oldest != choices_.end() && oldest->second.departed) choices_.erase(oldest);
  departed_.pop_front();
}

std::optional<bool> ChosenInstances::of(std::string_view instance) const {
  const config::ReadLock lock(mutex_);
  const auto found = choices_.find(instance);
  if (found == choices_.end()) return std::nullopt;
  return found->second.chosen;
}

}  // namespace iotcloud::topology
