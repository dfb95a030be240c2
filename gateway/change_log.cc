#include <algorithm>
#include <iterator>

#include <iotcloud/gateway/change_file.h>
#include <iotcloud/gateway/change_log.h>

namespace iotcloud::gateway {

ChangeLog::ChangeLog(std::size_t most, const std::string& file) : most_(most) {
  if (file.empty()) return;
  file_ = std::make_unique<ChangeFile>(file, most);
  changes_ = file_->load();
  for (const auto& change : changes_) earlier_life_[change.instance] = change;
}

ChangeLog::~ChangeLog() = default;

void ChangeLog::add(StateChange change) {
  const std::lock_guard lock(mutex_);
  if (const auto last = earlier_life_.extract(change.instance); last && last.mapped() == change) return;
  changes_.push_back(std::move(change));
  if (changes_.size() > most_) changes_.pop_front();
  if (file_) file_->add(changes_);
}

std::vector<StateChange> ChangeLog::of(const std::string& instance) const {
  const std::lock_guard lock(mutex_);
  std::vector<StateChange> found;
  std::copy_if(changes_.begin(), changes_.end(), std::back_inserter(found),
               [&](const StateChange& change) { return instance.empty() || change.instance == instance; });
  return found;
}

}  // namespace iotcloud::gateway
