#include <algorithm>

#include <iotcloud/topology/endpoints/receiving/retries.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {

std::chrono::milliseconds Retries::pause_after(int tries) {
  constexpr std::chrono::milliseconds first{20}, longest{5000};
  return tries > 8 ? longest : std::min(longest, first * (1 << std::max(tries - 1, 0)));
}

const std::string& Retries::driver_of(const ChannelMessage& arrival) {
  return arrival.delivery.message.driver_id;
}

void Retries::add(ChannelMessage arrival, Instant now) {
  arrival.not_before = now + pause_after(arrival.tries);
  const auto entry = groups_.try_emplace(driver_of(arrival)).first;
  Group& group = entry->second;
  if (std::exchange(arrival.blocks, false)) group.under_way = false;
  unplan(*entry);
  ++group.failed;
  insert(group, std::move(arrival));
  if (!group.under_way) plan(*entry);
}

bool Retries::hold(ChannelMessage& arrival) {
  const auto entry = groups_.find(driver_of(arrival));
  if (entry == groups_.end()) return false;
  insert(entry->second, std::move(arrival));
  return true;
}

std::optional<ChannelMessage> Retries::next(Instant now) {
  while (!released_.empty()) {
    ChannelMessage arrival = std::move(released_.front());
    released_.pop_front();
    if (!hold(arrival)) return arrival;
  }
  if (agenda_.empty() || agenda_.begin()->first > now) return std::nullopt;
  const auto entry = groups_.find(agenda_.begin()->second);
  unplan(*entry);
  Group& group = entry->second;
  ChannelMessage arrival = std::move(group.waiting.front());
  group.waiting.pop_front();
  if (arrival.tries > 0) --group.failed;
  group.under_way = true;
  arrival.blocks = true;
  return arrival;
}

void Retries::done(const ChannelMessage& arrival) {
  if (!arrival.blocks) return;
  const auto entry = groups_.find(driver_of(arrival));
  if (entry == groups_.end()) return;
  Group& group = entry->second;
  group.under_way = false;
  if (group.failed > 0) {
    plan(*entry);
    return;
  }
  for (auto& waiting : group.waiting) released_.push_back(std::move(waiting));
  groups_.erase(entry);
}

std::optional<Retries::Instant> Retries::due() const {
  if (!released_.empty()) return Instant::min();
  if (agenda_.empty()) return std::nullopt;
  return agenda_.begin()->first;
}

void Retries::clear() {
  groups_.clear();
  agenda_.clear();
  released_.clear();
}

void Retries::insert(Group& group, ChannelMessage arrival) {
  const auto place =
      std::upper_bound(group.waiting.begin(), group.waiting.end(), arrival.sequence,
                       [](std::uint64_t sequence, const ChannelMessage& other) { return sequence < other.sequence; });
  group.waiting.insert(place, std::move(arrival));
}

void Retries::plan(Groups::value_type& entry) {
  entry.second.planned = entry.second.waiting.front().not_before;
  agenda_.emplace(*entry.second.planned, entry.first);
}

void Retries::unplan(Groups::value_type& entry) {
  if (const auto planned = std::exchange(entry.second.planned, std::nullopt)) agenda_.erase({*planned, entry.first});
}

}  // namespace iotcloud::topology
