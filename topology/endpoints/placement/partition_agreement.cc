#include <iotcloud/topology/endpoints/placement/partition_agreement.h>

namespace iotcloud::topology {

void PartitionAgreement::set(const Source& source, const std::string& channel, int count) {
  const config::MutexLock lock(mutex_);
  const std::string before = difference_of(source);
  auto& channels = counts_[source];
  if (count == 0) {
    channels.erase(channel);
  } else {
    channels[channel] = count;
  }
  if (channels.empty()) counts_.erase(source);
  if (difference_of(source) == before) return;
  for (const auto& [number, on_change] : listeners_) on_change();
}

std::string PartitionAgreement::difference(const Source& source) const {
  const config::MutexLock lock(mutex_);
  return difference_of(source);
}

std::string PartitionAgreement::difference_of(const Source& source) const {
  const auto found = counts_.find(source);
  if (found == counts_.end()) return {};
  const auto& [first, count] = *found->second.begin();
  for (const auto& [channel, other] : found->second) {
    if (other == count) continue;
    return "its topics of the channels \"" + first + "\" and \"" + channel + "\" have " + std::to_string(count) +
           " and " + std::to_string(other) +
           " partitions, so messages of one driver would not meet in one worker; give both topics the same number "
           "(kafka-topics.sh --alter --partitions)";
  }
  return {};
}

int PartitionAgreement::listen(std::function<void()> on_change) {
  const config::MutexLock lock(mutex_);
  listeners_[++last_listener_] = std::move(on_change);
  return last_listener_;
}

void PartitionAgreement::ignore(int listener) {
  const config::MutexLock lock(mutex_);
  listeners_.erase(listener);
}

}  // namespace iotcloud::topology
