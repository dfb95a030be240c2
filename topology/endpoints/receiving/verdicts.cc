#include <utility>

#include <iotcloud/topology/endpoints/receiving/verdicts.h>

namespace iotcloud::topology {

void Verdicts::told(const std::string& instance, std::optional<bool> chosen) {
  const std::lock_guard lock(mutex_);
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

std::optional<bool> Verdicts::of(const std::string& instance) const {
  const std::shared_lock lock(mutex_);
  const auto found = verdicts_.find(instance);
  if (found == verdicts_.end()) return std::nullopt;
  return found->second.chosen;
}

}  // namespace iotcloud::topology
