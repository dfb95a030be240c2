#include <utility>

#include <iotcloud/topology/endpoints/receiving/verdicts.h>

namespace iotcloud::topology {

void Verdicts::told(const discovery::InstanceId& instance, std::optional<bool> chosen) {
  const config::WriteLock lock(mutex_);
  if (chosen) {
    verdicts_[instance] = {*chosen, false};
    return;
  }
  const auto found = verdicts_.find(instance);
  if (found == verdicts_.end() || std::exchange(found->second.departed, true)) return;
  departed_.push_back(instance);
  if (departed_.size() <= most_departed) return;
  const auto oldest = verdicts_.find(departed_.front());
  if (oldest != verdicts_.end() && oldest->second.departed) verdicts_.erase(oldest);
  departed_.pop_front();
}

std::optional<bool> Verdicts::of(std::string_view instance) const {
  const config::ReadLock lock(mutex_);
  const auto found = verdicts_.find(instance);
  if (found == verdicts_.end()) return std::nullopt;
  return found->second.chosen;
}

}  // namespace iotcloud::topology
