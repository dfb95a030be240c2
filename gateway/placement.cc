#include <algorithm>

#include <iotcloud/gateway/placement.h>

namespace iotcloud::gateway {

std::vector<BrokerPlan> Placement::place(const std::string& driver) {
  std::vector<BrokerPlan> plans;
  for (const auto& broker : brokers_) {
    // The two kinds of groups take turns of their own: an instance has one of each, so one counter for both would put
    // all groups of a kind on the same of two servers.
    const auto next_url = [&](bool is_shared) -> const std::string& {
      return broker.urls[next_[{broker.name, is_shared}]++ % broker.urls.size()];
    };
    auto& shared = shared_[{broker.name, driver}];
    if (shared.empty()) shared = next_url(true);
    plans.push_back({broker.name, broker.type, next_url(false), shared});
  }
  return plans;
}

void Placement::learn(const std::string& driver, const std::vector<BrokerPlan>& plans) {
  for (const auto& plan : plans) {
    const auto broker =
        std::find_if(brokers_.begin(), brokers_.end(), [&](const auto& setting) { return setting.name == plan.name; });
    if (broker == brokers_.end()) continue;
    if (std::find(broker->urls.begin(), broker->urls.end(), plan.shared_url) == broker->urls.end()) continue;
    if (shared_.emplace(std::pair{plan.name, driver}, plan.shared_url).second) ++next_[{plan.name, true}];
    ++next_[{plan.name, false}];
  }
}

}  // namespace iotcloud::gateway
