#include <iotcloud/gateway/host/channel_tally.h>

namespace iotcloud::gateway {

void ChannelTally::lost(const std::string& fate, std::int64_t messages) {
  const config::MutexLock lock(mutex_);
  losses_.messages += messages;
  losses_.fate = fate;
  add(fate, messages);
}

void ChannelTally::refused(const std::string& fate) {
  const config::MutexLock lock(mutex_);
  add(fate, 1);
}

ChannelTally::Losses ChannelTally::losses() const {
  const config::MutexLock lock(mutex_);
  return losses_;
}

void ChannelTally::add(const std::string& fate, std::int64_t messages) {
  const bool full = lost_.size() >= most_fates && !lost_.contains(fate);
  lost_[full ? "others" : fate] += messages;
}

ChannelTally::Counts ChannelTally::counts() const {
  const config::MutexLock lock(mutex_);
  return {done_.load(std::memory_order_relaxed), lost_};
}

}  // namespace iotcloud::gateway
