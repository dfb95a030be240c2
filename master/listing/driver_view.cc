#include <utility>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/listing/driver_view.h>

namespace iotcloud::master {

using discovery::DriverRecord;
using discovery::Node;

DriverView::DriverView(discovery::Registry& registry, const discovery::Paths& paths, Options options)
    : registry_(registry), paths_(paths), options_(options) {}

DriverView::~DriverView() {
  std::map<std::string, Entry> all;
  {
    const config::MutexLock lock(mutex_);
    all.swap(entries_);
  }
  forget(std::move(all));
}

/// Destroys entries without the lock, because a watch's destructor waits for its callback, which takes the lock.
void DriverView::forget(std::map<std::string, Entry> gone) {
  gone.clear();
}

void DriverView::ordered(const discovery::InstanceId& instance) {
  const config::MutexLock lock(mutex_);
  if (!entries_.empty()) ordered_.insert(instance);
}

std::vector<DriverRecord> DriverView::list() {
  const config::MutexLock one_at_a_time(listing_);
  const auto instances = discovery::list_instances(registry_, paths_);
  std::vector<DriverRecord> drivers;
  if (instances.size() <= options_.few) {
    std::map<std::string, Entry> all;
    {
      const config::MutexLock lock(mutex_);
      all.swap(entries_);
      unread_ = 0;
      ordered_.clear();
    }
    forget(std::move(all));
    const auto nodes = registry_.get_readable(instances);
    for (std::size_t i = 0; i < instances.size(); ++i) {
      if (auto driver = discovery::driver_of(nodes[i], instances[i])) drivers.push_back(std::move(*driver));
    }
  } else {
    watch_all(instances);
    read_ordered(instances);
    wait_until_read();
    const config::MutexLock lock(mutex_);
    drivers.reserve(instances.size());
    for (const auto& path : instances) {
      if (const auto& record = entries_.at(path).record) drivers.push_back(*record);
    }
  }
  discovery::read_unnamed_channels(registry_, paths_, drivers);
  return drivers;
}

/// Watches new instances and forgets those that are gone.
void DriverView::watch_all(const std::vector<std::string>& instances) {
  std::map<std::string, Entry> gone;
  std::vector<std::string> fresh;
  {
    const config::MutexLock lock(mutex_);
    gone.swap(entries_);
    for (const auto& path : instances) {
      if (auto known = gone.extract(path)) {
        entries_.insert(std::move(known));
      } else {
        entries_.try_emplace(path);
        fresh.push_back(path);
      }
    }
    unread_ = 0;
    for (const auto& [path, entry] : entries_) unread_ += entry.read ? 0 : 1;
  }
  forget(std::move(gone));
  for (const auto& path : fresh) {
    auto watch = registry_.watch_node(path, [this, path](const std::optional<Node>& node) { take(path, node); });
    const config::MutexLock lock(mutex_);
    entries_.at(path).watch = std::move(watch);
  }
}

/// Called on the registry's dispatcher and by the listing thread: the record written later wins.
void DriverView::take(const std::string& path, const std::optional<Node>& node) {
  auto record = discovery::driver_of(node, path);
  const config::MutexLock lock(mutex_);
  const auto found = entries_.find(path);
  if (found == entries_.end()) return;
  auto& entry = found->second;
  const auto writing = node ? std::pair(node->created, node->version) : std::pair(entry.created, entry.version);
  if (!std::exchange(entry.read, true) && --unread_ == 0) all_read_.notify_all();
  if (writing < std::pair(entry.created, entry.version)) return;
  entry.created = writing.first;
  entry.version = writing.second;
  entry.record = std::move(record);
}

void DriverView::read_ordered(const std::vector<std::string>& instances) {
  std::vector<std::string> again;
  {
    const config::MutexLock lock(mutex_);
    if (ordered_.empty()) return;
    for (const auto& path : instances) {
      if (ordered_.contains(discovery::InstanceId(path.substr(path.rfind('/') + 1)))) again.push_back(path);
    }
    ordered_.clear();
  }
  const auto nodes = registry_.get_readable(again);
  for (std::size_t i = 0; i < again.size(); ++i) take(again[i], nodes[i]);
}

/// A watch of a node that this user may not read reports nothing, so what is not reported soon is read here.
void DriverView::wait_until_read() {
  std::vector<std::string> unread;
  {
    const config::MutexLock lock(mutex_);
    const auto all_read = [this]() IOTCLOUD_REQUIRES(mutex_) { return unread_ == 0; };
    if (all_read_.wait_for(mutex_, options_.watches_limit, all_read)) return;
    for (const auto& [path, entry] : entries_) {
      if (!entry.read) unread.push_back(path);
    }
  }
  const auto nodes = registry_.get_readable(unread);
  for (std::size_t i = 0; i < unread.size(); ++i) take(unread[i], nodes[i]);
}

}  // namespace iotcloud::master
