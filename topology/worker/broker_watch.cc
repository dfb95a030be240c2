#include <fmt/chrono.h>
#include <fmt/format.h>

#include <iotcloud/topology/worker/broker_watch.h>

namespace iotcloud::topology {

using brokers::ConnectionState;

std::vector<BrokerWatch::Link> BrokerWatch::look() {
  auto links = list_();
  const std::int64_t now_ms = clock_.wall_ms();
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  std::map<std::pair<std::string, std::string>, Link> seen;
  for (Link& link : links) {
    const std::pair key(link.broker, link.url);
    const auto before = seen_.find(key);
    const bool same = before != seen_.end() && before->second.state == link.state;
    link.since_ms = same ? before->second.since_ms : now_ms;
    link.since = same ? before->second.since : now;
    seen[key] = link;
    if (before != seen_.end()) seen_.erase(before);
  }
  const auto gauge = [&](const std::pair<std::string, std::string>& key) -> config::Gauge& {
    config::Labels labels = labels_;
    labels["broker"] = key.first;
    labels["url"] = key.second;
    return metrics_.gauge("iotcloud_broker_away", "1: a broker that is in use cannot be reached, or takes no messages",
                          labels);
  };
  for (const auto& [key, link] : seen) gauge(key).set(link.state == ConnectionState::connected ? 0 : 1);
  for (const auto& [key, gone] : seen_) gauge(key).set(0);  // nobody uses it any more
  seen_ = std::move(seen);
  return links;
}

std::string BrokerWatch::trouble() {
  std::string text;
  const auto now = clock_.now();
  for (const Link& link : look()) {
    if (link.state == ConnectionState::connected || now - link.since < grace) continue;
    text +=
        fmt::format("{}the broker {} ({}) {} since {:%FT%TZ}{}{}{}", text.empty() ? "" : "; ", link.broker, link.url,
                    link.state == ConnectionState::blocked ? "takes no messages" : "is away",
                    fmt::gmtime(static_cast<std::time_t>(link.since_ms / 1000)), link.why.empty() ? "" : ": ", link.why,
                    link.state == ConnectionState::blocked ? "" : " (start its server, or correct `brokers`)");
  }
  return text;
}

BrokerWatch::List links_of(std::shared_ptr<brokers::BrokerPool> pool) {
  return [pool = std::move(pool)] {
    std::vector<BrokerWatch::Link> links;
    for (const auto& [address, broker] : pool->in_use())
      links.push_back({address.broker, brokers::printable_url(broker->url()), broker->state(), 0, broker->problem()});
    return links;
  };
}

}  // namespace iotcloud::topology
