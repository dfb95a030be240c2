#include <utility>

#include <iotcloud/gateway/logger.h>
#include <iotcloud/gateway/record_writer.h>

namespace iotcloud::gateway {

namespace {

constexpr int race_attempts = 5;

using discovery::RegistryError;
using discovery::RegistryErrorCode;

/// Tries again when another gateway removes the driver's empty node between the creation of the parent and of the
/// child.
void put_again_when_parent_went(discovery::Registry& registry, const std::string& path, const std::string& data) {
  for (int attempt = 1;; ++attempt) {
    try {
      discovery::put(registry, path, data);
      return;
    } catch (const RegistryError& e) {
      if (e.code() != RegistryErrorCode::no_node || attempt == race_attempts) throw;
    }
  }
}

}  // namespace

void RecordWriter::resume() {
  paused_ = false;
  flush();
}

void RecordWriter::found(const discovery::DriverName& driver, const discovery::InstanceId& instance) {
  Entry& entry = entries_[instance];
  entry.under.insert(driver);
  if (entry.wanted && entry.wanted->name != driver) entry.stale = true;
}

bool RecordWriter::has_written(const discovery::InstanceId& instance) const {
  const auto found = entries_.find(instance);
  return found != entries_.end() && found->second.written;
}

void RecordWriter::restore() {
  std::vector<std::string> paths;
  std::vector<Entry*> wanted;
  for (auto& [instance, entry] : entries_) {
    if (!entry.wanted) continue;
    paths.push_back(paths_.instance(entry.wanted->name, instance));
    wanted.push_back(&entry);
  }
  const auto nodes = registry_.get_all(paths);
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    Entry& entry = *wanted[i];
    if (!entry.dirty && nodes[i] && nodes[i]->data == encode(*entry.wanted)) continue;
    entry.channels.reset();
    entry.shown.reset();
    entry.dirty = true;
  }
}

void RecordWriter::put(const discovery::DriverRecord& record) {
  auto& entry = entries_[record.instance];
  entry.under.insert(record.name);
  want(entry, record);
  write(record.instance, entry);
}

void RecordWriter::erase(const discovery::DriverName& driver, const discovery::InstanceId& instance) {
  auto& entry = entries_[instance];
  entry.under.insert(driver);
  want(entry, std::nullopt);
  if (write(instance, entry)) entries_.erase(instance);
}

/// What is known of the channels belongs to the record's path: with another driver's name it is void.
void RecordWriter::want(Entry& entry, std::optional<discovery::DriverRecord> record) {
  if (!record || !entry.wanted || entry.wanted->name != record->name) {
    entry.channels.reset();
    entry.shown.reset();
  }
  entry.wanted = std::move(record);
  entry.dirty = entry.wanted.has_value();
  entry.stale = true;
}

bool RecordWriter::flush() {
  bool all = true;
  for (auto it = entries_.begin(); it != entries_.end();) {
    const bool settled = !it->second.dirty && !it->second.stale;
    all = (settled || write(it->first, it->second)) && all;
    it = it->second.under.empty() ? entries_.erase(it) : std::next(it);
  }
  return all;
}

bool RecordWriter::write(const discovery::InstanceId& instance, Entry& entry) {
  if (paused_ || closed_ || registry_.session() != discovery::SessionState::connected) return false;
  try {
    if (entry.dirty) {
      write_record(*entry.wanted, entry);
      entry.dirty = false;
      entry.written = true;
    }
    if (entry.stale) {
      remove_unwanted(instance, entry);
      entry.stale = false;
    }
    told_away_ = false;
    return true;
  } catch (const RegistryError& e) {
    if (!told_away_) {
      logger.warn("{} {}: {}",
                  entry.dirty ? "the registry has not got the state of" : "the registry still has an old record of",
                  instance, e.what());
    }
    told_away_ = true;
    if (entry.dirty) {  // it is not known which channels were written
      entry.channels.reset();
      entry.shown.reset();
    }
    return false;
  }
}

void RecordWriter::remove_unwanted(const discovery::InstanceId& instance, Entry& entry) {
  for (auto driver = entry.under.begin(); driver != entry.under.end();) {
    if (entry.wanted && entry.wanted->name == *driver) {
      ++driver;
      continue;
    }
    remove_record(*driver, instance);
    driver = entry.under.erase(driver);
  }
}

void RecordWriter::write_record(const discovery::DriverRecord& record, Entry& entry) {
  const std::string path = paths_.instance(record.name, record.instance);
  const bool comes = record.state == discovery::DriverState::active;
  if (comes && entry.shown == record.channels) {  // the channels are unchanged: write the record only
    discovery::put(registry_, path, encode(record));
    return;
  }
  entry.shown.reset();
  if (!entry.channels) {
    const auto children = registry_.children(path);
    entry.channels.emplace();
    if (children) entry.channels->insert(children->begin(), children->end());
  }
  auto& present = *entry.channels;
  std::set<std::string> wanted;
  for (const auto& channel : record.channels) wanted.insert(channel.name);

  if (!comes || !registry_.get(path)) {
    auto first = record;
    if (comes) first.state = discovery::DriverState::starting;
    put_again_when_parent_went(registry_, path, encode(first));
  }
  for (const auto& channel : record.channels) {
    discovery::put(registry_, paths_.channel(record.name, record.instance, channel.name), encode(channel));
    present.insert(channel.name);
  }
  if (comes) discovery::put(registry_, path, encode(record));
  for (auto it = present.begin(); it != present.end();) {
    if (wanted.contains(*it)) {
      ++it;
      continue;
    }
    registry_.remove(paths_.channel(record.name, record.instance, *it));
    it = present.erase(it);
  }
  if (comes) entry.shown = record.channels;
}

void RecordWriter::remove_record(const discovery::DriverName& driver, const discovery::InstanceId& instance) {
  discovery::remove_tree(registry_, paths_.instance(driver, instance));
  try {
    registry_.remove(paths_.driver(driver));
  } catch (const RegistryError& e) {
    if (e.code() != RegistryErrorCode::not_empty) throw;  // not_empty: the driver has other instances
  }
}

}  // namespace iotcloud::gateway
