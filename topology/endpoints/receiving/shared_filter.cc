#include <utility>

#include <iotcloud/topology/endpoints/receiving/channel_reader.h>
#include <iotcloud/topology/endpoints/receiving/shared_filter.h>

namespace iotcloud::topology {

std::optional<Arrival> SharedFilter::pass(Arrival arrival, config::Clock::Instant now) {
  if (!arrival.reader->driver_id().empty()) return arrival;  // an exclusive channel: read because it is chosen
  const std::string& instance = arrival.delivery.message.driver_id;
  const auto line = waiting_.find(instance);
  if (line == waiting_.end()) {
    const auto chosen = verdicts_->of(instance);
    if (chosen.value_or(false)) return arrival;
    if (chosen || instance.empty()) {
      drop(arrival);
      return std::nullopt;
    }
  }
  const std::string key = instance;
  waiting_[key].push_back({std::move(arrival), now});
  ++waiting_count_;
  return std::nullopt;
}

std::optional<Arrival> SharedFilter::next(config::Clock::Instant now) {
  for (auto line = waiting_.begin(); line != waiting_.end();) {
    const auto chosen = verdicts_->of(line->first);
    auto& messages = line->second;
    while (!messages.empty()) {
      Waiting& first = messages.front();
      const bool gone = first.arrival.reader->closed();  // the broker delivers it again by itself
      if (!gone && !chosen && now - first.since < grace) break;
      Arrival arrival = std::move(first.arrival);
      messages.pop_front();
      --waiting_count_;
      if (gone) continue;
      if (!chosen.value_or(false)) {
        drop(arrival);
        continue;
      }
      if (messages.empty()) waiting_.erase(line);
      return arrival;
    }
    line = messages.empty() ? waiting_.erase(line) : std::next(line);
  }
  return std::nullopt;
}

void SharedFilter::drop(Arrival& arrival) {
  dropped_.add();
  arrival.delivery.settle(brokers::Settlement::accept);
}

void SharedFilter::clear() {
  waiting_.clear();
  waiting_count_ = 0;
}

}  // namespace iotcloud::topology
