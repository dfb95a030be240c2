#include <algorithm>

#include <iotcloud/gateway/fleet/placement.h>

namespace iotcloud::gateway {

namespace {

/// All servers in their order, rotated so that this one is first.
std::vector<std::string> starting_with(const std::string& url, std::vector<std::string> urls) {
  std::rotate(urls.begin(), std::find(urls.begin(), urls.end(), url), urls.end());
  return urls;
}

}  // namespace

std::vector<BrokerPlan> Placement::place(const discovery::DriverName& driver) {
  std::vector<BrokerPlan> plans;
  for (const auto& broker : brokers_) {
    const auto& urls = broker.options.urls;
    // Exclusive and shared groups have separate counters. Each instance has one group of each kind, so with one counter
    // and two servers all groups of a kind would be on the same server.
    const auto next_url = [&](bool is_shared) -> const std::string& {
      return urls[next_[{broker.name, is_shared}]++ % urls.size()];
    };
    auto& shared = shared_[{broker.name, driver}];
    if (shared.empty()) shared = next_url(true);
    brokers::BrokerOptions options = broker.options;
    options.urls.clear();
    plans.push_back({broker.name, broker.type, std::move(options), starting_with(next_url(false), urls),
                     starting_with(shared, urls)});
  }
  return plans;
}

void Placement::learn(const discovery::DriverName& driver, const std::vector<BrokerPlan>& plans) {
  for (const auto& plan : plans) {
    const auto broker =
        std::find_if(brokers_.begin(), brokers_.end(), [&](const auto& setting) { return setting.name == plan.name; });
    if (broker == brokers_.end() || plan.shared_urls.empty()) continue;
    const auto& urls = broker->options.urls;
    if (std::find(urls.begin(), urls.end(), plan.shared_urls.front()) == urls.end()) continue;
    if (shared_.emplace(std::pair{plan.name, driver}, plan.shared_urls.front()).second) ++next_[{plan.name, true}];
    ++next_[{plan.name, false}];
  }
}

}  // namespace iotcloud::gateway
