#include <iotcloud/gateway/host/losses.h>

namespace iotcloud::gateway {

void Losses::see(const discovery::InstanceId& instance, const std::string& channel,
                 const ChannelTally::Losses& losses) {
  const Key key{instance, channel};
  const auto before = known_.find(key);
  Known now = before == known_.end() ? Known{} : before->second;
  if (before == known_.end() || losses.messages < now.lost) now = {};  // it was opened anew
  if (losses.messages > now.lost) {
    now.last = clock_.now();
    if (now.since_ms == 0) now.since_ms = clock_.wall_ms();
    now.fate = losses.fate;
  } else if (now.since_ms != 0 && clock_.now() - now.last >= quiet) {
    now.since_ms = 0;
  }
  now.lost = losses.messages;
  seen_.emplace(key, std::move(now));
}

std::vector<LosingChannel> Losses::end() {
  known_.swap(seen_);
  std::vector<LosingChannel> losing;
  for (const auto& [key, known] : known_) {
    if (known.since_ms == 0) continue;
    if (losing.size() == most) break;
    losing.push_back({key.first, key.second, known.fate, known.since_ms});
  }
  return losing;
}

}  // namespace iotcloud::gateway
