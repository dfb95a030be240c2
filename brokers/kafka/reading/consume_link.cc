#include "iotcloud/brokers/kafka/reading/consume_link.h"

#include <algorithm>
#include <utility>

#include <pthread.h>

namespace iotcloud::brokers::kafka {

ConsumeLink::ConsumeLink(KafkaOptions options, Meters& meters, const config::Clock& clock, ConnectionLog& log)
    : options_(std::move(options)),
      clock_(clock),
      log_(log),
      reader_(std::make_shared<Reader>(options_.native_headers, meters, clock, [this] { wake_event_.signal(); })) {}

ConsumeLink::~ConsumeLink() {
  {
    const std::lock_guard lock(mutex_);
    closing_ = true;
  }
  wake_event_.signal();
  if (thread_.joinable()) thread_.join();
  reader_->close();
}

std::shared_ptr<Inlet> ConsumeLink::add(const Topic& topic, const SubscriptionOptions& options, Handler handler) {
  const std::lock_guard lock(mutex_);
  std::shared_ptr<Group>& group = groups_[options.group.empty() ? topic.name : options.group];
  if (!group) {
    auto member = std::make_shared<Member>(options.group.empty() ? topic.name : options.group);
    group = std::make_shared<Group>(options_, reader_, std::move(member), clock_, log_, wake_event_);
  }
  auto inlet = std::make_shared<Inlet>(group->member(), topic, options, std::move(handler));
  reader_->add(inlet);
  if (!thread_.joinable()) {
    reader_->start();
    thread_ = std::thread([this] { run(); });
    pthread_setname_np(thread_.native_handle(), "kafka-groups");
  }
  wake_event_.signal();
  return inlet;
}

void ConsumeLink::remove(const std::shared_ptr<Inlet>& inlet) {
  reader_->remove(inlet);
  wake_event_.signal();
}

ConnectionState ConsumeLink::state() const {
  const std::lock_guard lock(mutex_);
  if (closing_) return ConnectionState::closed;
  const bool all = std::all_of(groups_.begin(), groups_.end(),
                               [&](const auto& entry) { return reader_->connected(*entry.second->member()); });
  return all ? ConnectionState::connected : ConnectionState::connecting;
}

void ConsumeLink::run() {
  std::unique_lock lock(mutex_);
  while (!closing_ || !leaving_.empty() || !groups_.empty()) {
    std::vector<std::shared_ptr<Group>> serving = leaving_;
    for (auto entry = groups_.begin(); entry != groups_.end();) {
      const std::shared_ptr<Group>& group = entry->second;
      serving.push_back(group);
      if (!closing_ && !reader_->topics(*group->member()).empty()) {
        ++entry;
        continue;
      }
      // Nobody reads in it any more; who comes now makes another.
      leaving_.push_back(group);
      group->close();
      entry = groups_.erase(entry);
    }
    lock.unlock();
    std::chrono::milliseconds limit{1000};
    for (const auto& group : serving) limit = std::min(limit, group->serve());
    serving.clear();
    const std::size_t gone = std::erase_if(leaving_, [](const auto& group) { return group->closed(); });
    if (limit.count() > 0 && gone == 0) wake_event_.wait(-1, false, limit);
    lock.lock();
  }
}

}  // namespace iotcloud::brokers::kafka
