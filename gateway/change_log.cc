#include <algorithm>
#include <iterator>
#include <optional>

#include <iotcloud/gateway/change_file.h>
#include <iotcloud/gateway/change_log.h>

namespace iotcloud::gateway {

std::vector<StateChange> latest_of(std::vector<StateChange> changes, std::size_t most_bytes) {
  constexpr std::size_t of_each = 64;  // besides its texts
  std::size_t bytes = 0;
  const auto too_early = std::find_if(changes.rbegin(), changes.rend(), [&](const StateChange& change) {
    bytes += change.instance.str().size() + change.driver.str().size() + change.reason.size() + of_each;
    return bytes > most_bytes;
  });
  changes.erase(changes.begin(), too_early.base());
  return changes;
}

ChangeLog::ChangeLog(std::size_t most, const std::string& file) : most_(most) {
  if (file.empty()) return;
  file_ = std::make_unique<ChangeFile>(file, most);
  changes_ = file_->load();
  for (const auto& change : changes_) earlier_life_[change.instance] = change;
}

ChangeLog::~ChangeLog() = default;

void ChangeLog::add(const StateChange& change) {
  const config::MutexLock file_lock(file_mutex_);
  std::optional<std::deque<StateChange>> all;
  {
    const config::MutexLock lock(mutex_);
    if (const auto last = earlier_life_.extract(change.instance); last && last.mapped() == change) return;
    changes_.push_back(change);
    if (changes_.size() > most_) changes_.pop_front();
    if (file_ && file_->wants_all()) all = changes_;
  }
  if (!file_) return;
  if (all) {
    file_->replace(*all);
  } else {
    file_->append(change);
  }
}

void ChangeLog::sync() {
  const config::MutexLock file_lock(file_mutex_);
  if (file_) file_->sync();
}

std::vector<StateChange> ChangeLog::of(const discovery::InstanceId& instance) const {
  const config::MutexLock lock(mutex_);
  std::vector<StateChange> found;
  std::copy_if(changes_.begin(), changes_.end(), std::back_inserter(found),
               [&](const StateChange& change) { return instance.empty() || change.instance == instance; });
  return found;
}

}  // namespace iotcloud::gateway
