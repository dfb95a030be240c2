#include <algorithm>
#include <ctime>
#include <utility>

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <iotcloud/gateway/fleet/host_troubles.h>

namespace iotcloud::gateway {

namespace {

std::string time_text(std::int64_t wall_ms) {
  return fmt::format("{:%FT%TZ}", fmt::gmtime(static_cast<std::time_t>(wall_ms / 1000)));
}

/// What a host tells, without what would look like another entry.
std::string part_of(const std::string& told) {
  std::string text = told.substr(0, HostTroubles::longest_text);
  std::replace(text.begin(), text.end(), ';', ',');
  return text;
}

}  // namespace

void HostTroubles::put(const std::string& host, const std::vector<Stall>& stalls,
                       const std::vector<LosingChannel>& losing, std::int64_t wall_ms) {
  const config::MutexLock lock(mutex_);
  Told& told = hosts_[host];
  std::map<discovery::InstanceId, std::int64_t> hanging;
  for (const Stall& stall : stalls) {
    if (stall.time < grace || stall.instance.empty()) continue;
    const auto before = told.hanging.find(stall.instance);
    hanging[stall.instance] = before == told.hanging.end() ? wall_ms - stall.time.count() : before->second;
  }
  told.hanging = std::move(hanging);
  told.losing = losing;
  if (told.losing.size() > most) told.losing.resize(most);
}

void HostTroubles::forget(const std::string& host) {
  const config::MutexLock lock(mutex_);
  hosts_.erase(host);
}

std::string HostTroubles::trouble() const {
  std::string text;
  std::size_t named = 0, more = 0;
  const auto add = [&](const std::string& one) {
    if (named == most) {
      ++more;
      return;
    }
    ++named;
    text += (text.empty() ? "" : "; ") + one;
  };
  const config::MutexLock lock(mutex_);
  for (const auto& [host, told] : hosts_) {
    for (const auto& [instance, since_ms] : told.hanging) {
      add(fmt::format("instance {} hangs: a callback of its driver has not returned since {}", part_of(instance.str()),
                      time_text(since_ms)));
    }
  }
  for (const auto& [host, told] : hosts_) {
    for (const auto& channel : told.losing) {
      add(fmt::format("instance {} drops messages: channel {} since {}, {}", part_of(channel.instance.str()),
                      part_of(channel.channel), time_text(channel.since_ms), part_of(channel.fate)));
    }
  }
  if (more > 0) text += fmt::format("; {} more such instances", more);
  return text;
}

}  // namespace iotcloud::gateway
