#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/config/clock_name.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/gateway/host/channel_looks.h>

namespace iotcloud::gateway {

using discovery::ChannelLook;
using discovery::SeenMessage;

namespace {

std::int64_t us(config::Clock::Instant::duration time) {
  return std::chrono::duration_cast<std::chrono::microseconds>(time).count();
}

/// The smaller of two numbers, of which 0 is none.
std::int64_t least(std::int64_t known, std::int64_t number) {
  return known == 0 ? number : std::min(known, number);
}

}  // namespace

void ChannelLooks::saw(const brokers::Message& message, const Passage& passage) {
  const auto now = clock_.now();
  const auto size = static_cast<std::int64_t>(message.payload.size());
  const config::MutexLock lock(mutex_);
  end_silent_looks(now);
  for (auto& [name, look] : looks_) {
    ChannelLook& seen = look.seen;
    if (look.last) {
      const std::int64_t gap = std::max<std::int64_t>(1, us(now - *look.last));
      seen.shortest_us = least(seen.shortest_us, gap);
      seen.longest_us = std::max(seen.longest_us, gap);
    }
    look.last = now;
    seen.smallest = least(seen.smallest, size);
    seen.largest = std::max(seen.largest, size);
    ++seen.count;
    seen.bytes += size;
    if (!keeps(look, message)) continue;
    const auto part = message.payload.text().substr(0, static_cast<std::size_t>(look.bytes));
    std::size_t takes = part.size();
    for (const auto& [key, value] : message.properties) takes += key.size() + value.size();
    if (seen.messages.size() >= static_cast<std::size_t>(look.most) ||
        look.kept_bytes + takes > static_cast<std::size_t>(discovery::most_seen_bytes)) {
      ++seen.missed;
      continue;
    }
    look.kept_bytes += takes;
    SeenMessage kept;
    kept.number = seen.count;
    kept.seen_ms = clock_.wall_ms();
    kept.time_ms = message.time_ms;
    kept.size = size;
    kept.payload = part;
    for (const auto& [key, value] : message.properties) kept.properties[key] = value;
    if (look.every_ms > 0) {
      kept.begin_us = us(passage.begin.time_since_epoch());
      if (passage.came) kept.came_us = us(passage.came->time_since_epoch());
      const auto end = std::find_if(ends_.begin(), ends_.end(),
                                    [&](const End& one) { return passage.key != 0 && one.key == passage.key; });
      if (end != ends_.end()) note(kept, *end);
    }
    seen.messages.push_back(std::move(kept));
    look.keys.push_back(passage.key);
  }
}

/// Whether the message is to be in the look's next answer, if there is room.
bool ChannelLooks::keeps(Look& look, const brokers::Message& message) const {
  if (look.most == 0) return false;
  if (look.every_ms == 0) return true;
  const std::int64_t slot = message.time_ms / look.every_ms;
  return std::exchange(look.slot, slot) != slot;
}

void ChannelLooks::note(SeenMessage& seen, const End& end) {
  seen.end_us = us(end.at.time_since_epoch());
  seen.fate = end.fate;
}

void ChannelLooks::ended(std::uint64_t key, const std::string& fate) {
  const config::MutexLock lock(mutex_);
  ends_.push_back({key, clock_.now(), fate});
  if (ends_.size() > most_ends) ends_.pop_front();
  for (auto& [name, look] : looks_) {
    if (look.every_ms == 0) continue;
    const auto found = std::find(look.keys.begin(), look.keys.end(), key);
    if (found != look.keys.end())
      note(look.seen.messages[static_cast<std::size_t>(found - look.keys.begin())], ends_.back());
  }
}

/// Moves the messages into the answer; with every_ms those whose end is known, or that are a second old.
void ChannelLooks::take_told(Look& look, config::Clock::Instant now, ChannelLook& answer) const {
  std::vector<SeenMessage> rest;
  std::vector<std::uint64_t> keys;
  const std::int64_t oldest_us = us((now - longest_wait).time_since_epoch());
  for (std::size_t place = 0; place < look.seen.messages.size(); ++place) {
    auto& message = look.seen.messages[place];
    const bool waits =
        look.every_ms > 0 && look.keys[place] != 0 && message.end_us == 0 && message.begin_us > oldest_us;
    (waits ? rest : answer.messages).push_back(std::move(message));
    if (waits) keys.push_back(look.keys[place]);
  }
  look.seen.messages = std::move(rest);
  look.keys = std::move(keys);
  if (look.every_ms == 0) return;
  answer.host = config::host_name();
  answer.clock = config::system_clock_name();
  answer.wall_us = clock_.wall_ms() * 1000 - us(now.time_since_epoch());
}

void ChannelLooks::answer(const discovery::LookRequest& request, ChannelLook& answer) {
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  end_silent_looks(now);
  auto found = looks_.find(request.look);
  if (found == looks_.end()) {
    if (request.last) return;
    if (looks_.size() >= most_looks) {
      answer.problem =
          fmt::format("{} others look at channel \"{}\" now, and no more may; try again when one has ended",
                      looks_.size(), request.channel);
      return;
    }
    found = looks_.emplace(request.look, Look{}).first;
    found->second.began = now;
    watched_ = true;
  }
  Look& look = found->second;
  look.asked = now;
  look.most = std::clamp(request.most, 0, discovery::most_seen_messages);
  look.bytes = std::clamp(request.bytes, 0, discovery::most_seen_bytes);
  look.every_ms = std::max(request.every_ms, 0);
  look.kept_bytes = 0;
  ChannelLook& seen = look.seen;
  answer.elapsed_us = us(now - look.began);
  answer.count = seen.count;
  answer.bytes = seen.bytes;
  answer.missed = seen.missed;
  answer.shortest_us = std::exchange(seen.shortest_us, 0);
  answer.longest_us = std::exchange(seen.longest_us, 0);
  answer.smallest = std::exchange(seen.smallest, 0);
  answer.largest = std::exchange(seen.largest, 0);
  take_told(look, now, answer);
  if (request.last) {
    looks_.erase(found);
    watched_ = !looks_.empty();
  }
}

void ChannelLooks::end_silent_looks(config::Clock::Instant now) {
  std::erase_if(looks_, [&](const auto& entry) { return now - entry.second.asked >= longest_silence; });
  watched_ = !looks_.empty();
  if (looks_.empty()) ends_.clear();
}

}  // namespace iotcloud::gateway
