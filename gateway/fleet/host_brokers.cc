#include <algorithm>
#include <ctime>
#include <utility>

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <iotcloud/gateway/fleet/host_brokers.h>

namespace iotcloud::gateway {

void HostBrokers::put(const std::string& host, std::vector<BrokerLink> links, config::Clock::Instant now) {
  const config::MutexLock lock(mutex_);
  std::vector<Told>& before = hosts_[host];
  std::vector<Told> told;
  for (BrokerLink& link : links) {
    const auto same = std::find_if(before.begin(), before.end(), [&](const Told& one) {
      return one.link.broker == link.broker && one.link.url == link.url && one.link.state == link.state;
    });
    told.push_back({std::move(link), same == before.end() ? now : same->since});
  }
  before = std::move(told);
}

void HostBrokers::forget(const std::string& host) {
  const config::MutexLock lock(mutex_);
  hosts_.erase(host);
}

std::string HostBrokers::trouble(config::Clock::Instant now) const {
  std::map<std::pair<std::string, std::string>, BrokerLink> away;  // several hosts may use one broker
  {
    const config::MutexLock lock(mutex_);
    for (const auto& [host, links] : hosts_) {
      for (const auto& [link, since] : links) {
        if (link.state == "connected" || now - since < grace) continue;
        const auto [known, fresh] = away.try_emplace({link.broker, link.url}, link);
        if (!fresh && link.since_ms < known->second.since_ms) known->second = link;
      }
    }
  }
  std::string text;
  for (const auto& [key, link] : away) {
    text += fmt::format("{}the broker {} ({}) {} since {:%FT%TZ}{}{}{}", text.empty() ? "" : "; ", link.broker,
                        link.url, link.state == "away" ? "is away" : link.state,
                        fmt::gmtime(static_cast<std::time_t>(link.since_ms / 1000)), link.why.empty() ? "" : ": ",
                        link.why, link.state == "away" ? " (start its server, or correct `brokers`)" : "");
  }
  return text;
}

}  // namespace iotcloud::gateway
