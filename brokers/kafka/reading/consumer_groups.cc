#include "iotcloud/brokers/kafka/reading/consumer_groups.h"

#include <algorithm>
#include <utility>

#include <pthread.h>

namespace iotcloud::brokers::kafka {

namespace {

/// The group whose members exclude one another from a partition. Partition 0 keeps the group's own name, so that a
/// topic which is given more partitions is read on from where it was.
std::string group_name(const std::string& group, std::optional<std::int32_t> partition) {
  return partition.value_or(0) == 0 ? group : group + "#" + std::to_string(*partition);
}

}  // namespace

ConsumerGroups::ConsumerGroups(KafkaOptions options, Meters& meters, const config::Clock& clock, ConnectionLog& log)
    : options_(std::move(options)),
      clock_(clock),
      log_(log),
      reader_(std::make_shared<PartitionReader>(options_.native_headers, meters, clock,
                                                [this] { wake_event_.signal(); })) {}

ConsumerGroups::~ConsumerGroups() {
  std::thread thread;
  {
    const config::MutexLock lock(mutex_);
    closing_ = true;
    thread = std::move(thread_);
  }
  wake_event_.signal();
  if (thread.joinable()) thread.join();
  reader_->close();
}

std::shared_ptr<TopicSubscriber> ConsumerGroups::add(const Topic& topic, const SubscriptionOptions& options,
                                                     Handler handler) {
  const config::MutexLock lock(mutex_);
  const std::string& name = options.group.empty() ? topic.name : options.group;
  std::shared_ptr<ConsumerGroup>& group = groups_[{name, options.partition}];
  if (!group) {
    auto member = std::make_shared<GroupMember>(group_name(name, options.partition), options.partition);
    group = std::make_shared<ConsumerGroup>(options_, reader_, std::move(member), clock_, log_, wake_event_);
  }
  auto subscriber = std::make_shared<TopicSubscriber>(group->member(), topic, options, std::move(handler));
  reader_->add(subscriber);
  if (!thread_.joinable()) {
    reader_->start();
    thread_ = std::thread([this] { run(); });
    pthread_setname_np(thread_.native_handle(), "kafka-groups");
  }
  wake_event_.signal();
  return subscriber;
}

void ConsumerGroups::remove(const std::shared_ptr<TopicSubscriber>& subscriber) {
  reader_->remove(subscriber);
  wake_event_.signal();
}

ConnectionState ConsumerGroups::state() const {
  const config::MutexLock lock(mutex_);
  if (closing_) return ConnectionState::closed;
  const bool all = std::all_of(groups_.begin(), groups_.end(),
                               [&](const auto& entry) { return reader_->connected(*entry.second->member()); });
  return all ? ConnectionState::connected : ConnectionState::connecting;
}

std::vector<std::shared_ptr<ConsumerGroup>> ConsumerGroups::groups_to_serve() {
  std::vector<std::shared_ptr<ConsumerGroup>> serving = leaving_;
  for (auto entry = groups_.begin(); entry != groups_.end();) {
    const std::shared_ptr<ConsumerGroup>& group = entry->second;
    serving.push_back(group);
    if (!closing_ && !reader_->topics(*group->member()).empty()) {
      ++entry;
      continue;
    }
    // No subscription reads in this group any more; a new one makes another ConsumerGroup object.
    leaving_.push_back(group);
    group->close();
    entry = groups_.erase(entry);
  }
  return serving;
}

void ConsumerGroups::run() {
  on_thread_.assert_held();
  const config::MutexLock lock(mutex_);
  while (!closing_ || !leaving_.empty() || !groups_.empty()) {
    std::vector<std::shared_ptr<ConsumerGroup>> serving = groups_to_serve();
    const config::Unlocked unlocked(mutex_);
    std::chrono::milliseconds limit{1000};
    for (const auto& group : serving) limit = std::min(limit, group->serve());
    serving.clear();
    const std::size_t gone = std::erase_if(leaving_, [](const auto& group) { return group->closed(); });
    if (limit.count() > 0 && gone == 0) wake_event_.wait(-1, false, limit);
  }
}

}  // namespace iotcloud::brokers::kafka
