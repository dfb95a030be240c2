#include <chrono>

#include <iotcloud/config/error.h>
#include <iotcloud/topology/endpoints/logger.h>
#include <iotcloud/topology/endpoints/receiving/split_topics.h>

namespace iotcloud::topology {

void SplitTopics::begin() {
  listener_ = options_.agreement->listen([this] {
    const config::MutexLock lock(mutex_);
    agreement_changed_ = true;
    change_soon();
  });
}

void SplitTopics::end() {
  if (const int listener = std::exchange(listener_, 0)) options_.agreement->ignore(listener);
  discovery::GuardPtr planned;
  {
    const config::MutexLock lock(mutex_);
    over_ = true;
    planned.swap(soon_);
  }
  planned.reset();  // waits for on_change; so no lock is held
  for (const auto& [key, topic] : topics_) {
    for (const auto& [instance, channel] : topic.channels) options_.agreement->forget(source_of(channel), channel.name);
  }
  topics_.clear();
}

std::optional<int> SplitTopics::follow(const discovery::ChannelRecord& channel, const Key& key) {
  const auto [place, fresh] = topics_.try_emplace(key);
  SplitTopic& topic = place->second;
  topic.channels.insert_or_assign(channel.instance, channel);
  if (fresh && !channel.shared) topic.layout = Layout{.exclusive = true, .partitions = {}};
  if (fresh && channel.shared) {
    try {
      topic.broker = options_.broker_at(key.first);
      topic.watch = topic.broker->watch_partitions(key.second, [this, key](int count) { on_count(key, count); });
      if (!topic.watch) topic.layout.emplace();
    } catch (const config::Error& error) {  // SpoutPlacement::open_reader() logs it as an error
      endpoints_logger.debug("{}: {}", options_.component, error.what());
    }
  }
  if (topic.layout) options_.agreement->set(source_of(channel), channel.name, *topic.layout);
  if (!topic.watch) return std::nullopt;
  return topic.partitions();
}

void SplitTopics::forget(const discovery::ChannelRecord& channel, const Key& key) {
  const auto found = topics_.find(key);
  if (found == topics_.end()) return;
  if (found->second.channels.erase(channel.instance) == 0) return;
  options_.agreement->forget(source_of(channel), channel.name);
  if (found->second.channels.empty()) topics_.erase(found);
}

std::string SplitTopics::difference(const discovery::ChannelRecord& channel) const {
  return options_.agreement->difference(source_of(channel));
}

/// The broker calls it on its own thread.
void SplitTopics::on_count(const Key& topic, int count) {
  const config::MutexLock lock(mutex_);
  told_[topic] = count;
  change_soon();
}

void SplitTopics::change_soon() {
  if (over_ || soon_) return;
  soon_ = options_.registry->after(std::chrono::milliseconds(0), options_.on_change);
}

SplitTopics::Changes SplitTopics::take_changes() {
  Changes changes;
  std::map<Key, int> told;
  discovery::GuardPtr planned;  // destroyed here, inside its own call of on_change, so that nobody waits for that call
  {
    const config::MutexLock lock(mutex_);
    told.swap(told_);
    planned.swap(soon_);
    changes.all = std::exchange(agreement_changed_, false);
  }
  for (const auto& [key, count] : told) {
    const auto found = topics_.find(key);
    if (found == topics_.end()) continue;
    SplitTopic& topic = found->second;
    const bool changed = topic.partitions() != count;
    topic.layout = Layout{.exclusive = false, .partitions = count};
    endpoints_logger.debug("{}: topic {} has {} partitions", options_.component, key.second.name, count);
    for (const auto& [instance, channel] : topic.channels) {
      if (changed) changes.instances.insert(instance);
      options_.agreement->set(source_of(channel), channel.name, *topic.layout);
    }
  }
  return changes;
}

PartitionAgreement::Source SplitTopics::source_of(const discovery::ChannelRecord& channel) const {
  return {options_.group, channel.driver, channel.gateway, channel.instance};
}

}  // namespace iotcloud::topology
