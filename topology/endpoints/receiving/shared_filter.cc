#include <utility>

#include <iotcloud/topology/endpoints/receiving/shared_filter.h>
#include <iotcloud/topology/endpoints/receiving/topic_reader.h>

namespace iotcloud::topology {

std::optional<ChannelMessage> SharedFilter::pass(ChannelMessage arrival, config::Clock::Instant now) {
  // an exclusive channel: it is read only if its instance is chosen
  if (!arrival.reader->sender().driver.empty()) return arrival;
  const std::string& instance = arrival.delivery.message.driver_id;
  const auto line = waiting_.find(instance);
  if (line == waiting_.end()) {
    const auto chosen = chosen_instances_->of(instance);
    if (chosen.value_or(false)) return arrival;
    if (chosen || instance.empty()) {
      drop(arrival);
      return std::nullopt;
    }
  }
  auto& queue = waiting_[discovery::InstanceId(instance)];
  queue.push_back({std::move(arrival), now});
  ++waiting_count_;
  return std::nullopt;
}

std::optional<ChannelMessage> SharedFilter::next(config::Clock::Instant now) {
  for (auto line = waiting_.begin(); line != waiting_.end();) {
    const auto chosen = chosen_instances_->of(line->first.str());
    auto& messages = line->second;
    while (!messages.empty()) {
      Waiting& first = messages.front();
      const bool gone = first.arrival.reader->closed();  // the broker delivers it again by itself
      if (!gone && !chosen && now - first.since < grace) break;
      ChannelMessage arrival = std::move(first.arrival);
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

void SharedFilter::drop(ChannelMessage& arrival) {
  dropped_.add();
  arrival.delivery.settle(brokers::Settlement::accept);
}

void SharedFilter::clear() {
  waiting_.clear();
  waiting_count_ = 0;
}

}  // namespace iotcloud::topology
