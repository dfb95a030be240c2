#include <algorithm>
#include <iterator>

#include <iotcloud/gateway/change_log.h>

namespace iotcloud::gateway {

void ChangeLog::add(StateChange change) {
  const std::lock_guard lock(mutex_);
  changes_.push_back(std::move(change));
  if (changes_.size() > most_) changes_.pop_front();
}

std::vector<StateChange> ChangeLog::of(const std::string& instance) const {
  const std::lock_guard lock(mutex_);
  std::vector<StateChange> found;
  std::copy_if(changes_.begin(), changes_.end(), std::back_inserter(found),
               [&](const StateChange& change) { return instance.empty() || change.instance == instance; });
  return found;
}

}  // namespace iotcloud::gateway
