#include <utility>

#include <iotcloud/topology/endpoints/receiving/known_instances.h>

namespace iotcloud::topology {

void KnownInstances::told(const discovery::InstanceId& instance, const discovery::GatewayId& gateway, bool chosen) {
  const config::WriteLock lock(mutex_);
  const auto [known, fresh] = known_.insert_or_assign(instance, Known{gateway, chosen, false});
  if (fresh) news_.fetch_add(1, std::memory_order_relaxed);
}

void KnownInstances::gone(const discovery::InstanceId& instance) {
  const config::WriteLock lock(mutex_);
  const auto found = known_.find(instance);
  if (found == known_.end() || std::exchange(found->second.departed, true)) return;
  departed_.push_back(instance);
  if (departed_.size() <= most_departed) return;
  const auto oldest = known_.find(departed_.front());
  if (oldest != known_.end() && oldest->second.departed) known_.erase(oldest);
  departed_.pop_front();
}

KnownInstances::Standing KnownInstances::of(std::string_view instance, const discovery::GatewayId& gateway) const {
  const config::ReadLock lock(mutex_);
  const auto found = known_.find(instance);
  if (found == known_.end()) return Standing::unknown;
  const Known& known = found->second;
  if (!known.gateway.empty() && known.gateway != gateway) return Standing::elsewhere;
  return known.chosen ? Standing::chosen : Standing::unchosen;
}

bool KnownInstances::may_be_chosen(const discovery::InstanceId& instance) const {
  const config::ReadLock lock(mutex_);
  const auto found = known_.find(instance);
  return found == known_.end() || found->second.chosen;
}

}  // namespace iotcloud::topology
