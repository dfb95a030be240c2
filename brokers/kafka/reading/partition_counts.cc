#include "iotcloud/brokers/kafka/reading/partition_counts.h"

#include <algorithm>
#include <exception>
#include <utility>

#include <pthread.h>

#include <iotcloud/brokers/kafka/logger.h>

namespace iotcloud::brokers::kafka {
namespace {

constexpr std::chrono::milliseconds longest_answer{2000};  // the destructor may have to wait for it

}  // namespace

// A consumer without a group: a producer's question would make the topic.
PartitionCounts::PartitionCounts(const KafkaOptions& options, const config::Clock& clock)
    : options_(options),
      clock_(clock),
      renewal_(options, [this] { return std::make_shared<KafkaClient>(RD_KAFKA_CONSUMER, options_, Settings{}, 0); }) {}

PartitionCounts::~PartitionCounts() {
  std::thread thread;
  {
    const config::MutexLock lock(mutex_);
    closing_ = true;
    thread = std::move(thread_);
  }
  changed_.notify_all();
  if (thread.joinable()) thread.join();
}

int PartitionCounts::follow(const std::string& topic, std::function<void(int)> told) {
  const config::MutexLock lock(mutex_);
  Follower& follower = followers_[++last_];
  follower.topic = topic;
  follower.told = std::move(told);
  if (!thread_.joinable()) {
    thread_ = std::thread([this] { run(); });
    pthread_setname_np(thread_.native_handle(), "kafka-topics");
  }
  changed_.notify_all();
  return last_;
}

void PartitionCounts::ignore(int follower) {
  const config::MutexLock lock(mutex_);
  followers_.erase(follower);
  while (telling_ == follower) changed_.wait(mutex_);
}

void PartitionCounts::run() {
  on_thread_.assert_held();
  const config::MutexLock lock(mutex_);
  while (!closing_) {
    const Instant next = ask_due(clock_.now());
    if (!closing_ && next > clock_.now()) {
      if (followers_.empty()) {
        changed_.wait(mutex_);
      } else {
        clock_.wait_until(changed_, mutex_, next);
      }
    }
  }
  const config::Unlocked unlocked(mutex_);
  client_.reset();
}

/// Asks for the topics that are due. \return when the next one is due
PartitionCounts::Instant PartitionCounts::ask_due(Instant now) {
  Instant next = now + ask_period;
  for (auto place = followers_.begin(); place != followers_.end() && !closing_;) {
    const int number = place->first;
    if (place->second.ask_at <= now) {
      const std::string topic = place->second.topic;
      int count = 0;
      {
        const config::Unlocked unlocked(mutex_);
        count = ask(topic);
      }
      tell(number, count);
    }
    if (const auto still = followers_.find(number); still != followers_.end()) {
      next = std::min(next, still->second.ask_at);
    }
    place = followers_.upper_bound(number);
  }
  return next;
}

/// \return 0: no server knows the topic, or none answers
int PartitionCounts::ask(const std::string& topic) {
  on_thread_.assert_held();
  try {
    if (!client_ || renewal_.ready(clock_.now())) client_ = renewal_.client();
    if (!client_->connected()) {
      client_->refresh_credentials(options_, clock_.now());
      return 0;
    }
    return client_->partitions(topic, std::min(options_.broker.rpc_timeout, longest_answer));
  } catch (const std::exception& error) {  // the readers say what is wrong with the connection
    logger.debug("topic {}: {}", topic, error.what());
    return 0;
  }
}

void PartitionCounts::tell(int number, int count) {
  const auto found = followers_.find(number);
  if (found == followers_.end()) return;
  Follower& follower = found->second;
  if (count == 0) {
    follower.ask_at = clock_.now() + follower.backoff.next();
    return;
  }
  follower.ask_at = clock_.now() + ask_period;
  follower.backoff.reset();
  if (std::exchange(follower.count, count) == count) return;
  const std::function<void(int)> told = follower.told;  // a copy: ignore() may remove it meanwhile
  telling_ = number;
  {
    const config::Unlocked unlocked(mutex_);
    told(count);
  }
  telling_ = 0;
  changed_.notify_all();
}

}  // namespace iotcloud::brokers::kafka
