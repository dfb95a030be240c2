#include <ctime>
#include <utility>

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <iotcloud/gateway/fleet/host_brokers.h>

namespace iotcloud::gateway {

void HostBrokers::put(const std::string& host, std::vector<BrokerLink> links) {
  const config::MutexLock lock(mutex_);
  hosts_[host] = std::move(links);
}

void HostBrokers::forget(const std::string& host) {
  const config::MutexLock lock(mutex_);
  hosts_.erase(host);
}

std::string HostBrokers::trouble(std::int64_t now_ms) const {
  std::map<std::pair<std::string, std::string>, BrokerLink> away;  // several hosts may use one broker
  {
    const config::MutexLock lock(mutex_);
    for (const auto& [host, links] : hosts_) {
      for (const BrokerLink& link : links) {
        if (link.state == "connected" || now_ms - link.since_ms < grace.count()) continue;
        const auto [known, fresh] = away.try_emplace({link.broker, link.url}, link);
        if (!fresh && link.since_ms < known->second.since_ms) known->second = link;
      }
    }
  }
  std::string text;
  for (const auto& [key, link] : away) {
    text += fmt::format("{}the broker {} ({}) {} since {:%FT%TZ}{}{}", text.empty() ? "" : "; ", link.broker, link.url,
                        link.state == "away" ? "is away" : link.state,
                        fmt::gmtime(static_cast<std::time_t>(link.since_ms / 1000)), link.why.empty() ? "" : ": ",
                        link.why);
  }
  return text;
}

}  // namespace iotcloud::gateway
