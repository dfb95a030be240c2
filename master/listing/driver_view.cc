#include <utility>

#include <iotcloud/discovery/directory.h>
#include <iotcloud/master/listing/driver_view.h>

namespace iotcloud::master {

using discovery::DriverRecord;
using discovery::Node;
using discovery::RegistryError;
using discovery::RegistryErrorCode;

DriverView::DriverView(discovery::Registry& registry, const discovery::Paths& paths, Options options)
    : registry_(registry), paths_(paths), options_(options) {}

DriverView::~DriverView() {
  std::map<std::string, Entry> all;
  {
    const std::lock_guard lock(mutex_);
    all.swap(entries_);
  }
  forget(std::move(all));
}

/// Without the lock: a watch's destructor waits for its callback, which wants the lock.
void DriverView::forget(std::map<std::string, Entry> gone) {
  gone.clear();
}

void DriverView::ordered(const std::string& instance) {
  const std::lock_guard lock(mutex_);
  if (!entries_.empty()) ordered_.insert(instance);
}

std::vector<DriverRecord> DriverView::list() {
  const std::lock_guard one_at_a_time(listing_);
  const auto instances = discovery::list_instances(registry_, paths_);
  std::vector<DriverRecord> drivers;
  if (instances.size() <= options_.few) {
    std::map<std::string, Entry> all;
    {
      const std::lock_guard lock(mutex_);
      all.swap(entries_);
      unread_ = 0;
      ordered_.clear();
    }
    forget(std::move(all));
    const auto nodes = registry_.get_all(instances);
    for (std::size_t i = 0; i < instances.size(); ++i) {
      if (auto driver = discovery::driver_of(nodes[i], instances[i])) drivers.push_back(std::move(*driver));
    }
  } else {
    watch_all(instances);
    read_ordered(instances);
    wait_until_read();
    const std::lock_guard lock(mutex_);
    drivers.reserve(instances.size());
    for (const auto& path : instances) {
      if (const auto& record = entries_.at(path).record) drivers.push_back(*record);
    }
  }
  discovery::read_unnamed_channels(registry_, paths_, drivers);
  return drivers;
}

/// Watches what is new, and forgets what is gone.
void DriverView::watch_all(const std::vector<std::string>& instances) {
  std::map<std::string, Entry> gone;
  std::vector<std::string> fresh;
  {
    const std::lock_guard lock(mutex_);
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
    const std::lock_guard lock(mutex_);
    entries_.at(path).watch = std::move(watch);
  }
}

/// On the registry's dispatcher, or by the one who lists: the later writing counts.
void DriverView::take(const std::string& path, const std::optional<Node>& node) {
  auto record = discovery::driver_of(node, path);
  const std::lock_guard lock(mutex_);
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
    const std::lock_guard lock(mutex_);
    if (ordered_.empty()) return;
    for (const auto& path : instances) {
      if (ordered_.contains(path.substr(path.rfind('/') + 1))) again.push_back(path);
    }
    ordered_.clear();
  }
  const auto nodes = registry_.get_all(again);
  for (std::size_t i = 0; i < again.size(); ++i) take(again[i], nodes[i]);
}

void DriverView::wait_until_read() {
  std::unique_lock lock(mutex_);
  if (all_read_.wait_for(lock, options_.first_limit, [this] { return unread_ == 0; })) return;
  throw RegistryError(RegistryErrorCode::away, "the records of all driver instances were not read in time");
}

}  // namespace iotcloud::master
