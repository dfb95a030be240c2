#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "iotcloud/brokers/client/wake_event.h"
#include "iotcloud/brokers/kafka/reading/group.h"
#include "iotcloud/brokers/kafka/reading/partition_reader.h"
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::kafka {

/// All reading of one broker object: the reader's thread, which runs the handlers, and the thread that serves the
/// groups. Subscriptions of one group share one consumer; those to a single partition (SubscriptionOptions::partition)
/// share one for each number of a partition. Thread safe.
class ConsumerGroups {
 public:
  ConsumerGroups(KafkaOptions options, Meters& meters, const config::Clock& clock, ConnectionLog& log);
  /// Leaves all groups in order. Not to be called from a handler.
  ~ConsumerGroups();
  ConsumerGroups(const ConsumerGroups&) = delete;
  ConsumerGroups& operator=(const ConsumerGroups&) = delete;

  /// Adds a subscription. The first one starts the threads.
  std::shared_ptr<TopicSubscriber> add(const Topic& topic, const SubscriptionOptions& options, Handler handler);
  void remove(const std::shared_ptr<TopicSubscriber>& subscriber);
  PartitionReader& reader() { return *reader_; }
  ConnectionState state() const;  ///< `connected` also when there is no subscription

 private:
  void run();
  /// Begins to leave the groups without subscriptions. \return all groups that are to be served
  std::vector<std::shared_ptr<ConsumerGroup>> groups_to_serve() IOTCLOUD_REQUIRES(mutex_, on_thread_);

  const KafkaOptions options_;
  const config::Clock& clock_;
  ConnectionLog& log_;
  client::WakeEvent wake_event_;
  const std::shared_ptr<PartitionReader> reader_;

  mutable config::Mutex mutex_;
  bool closing_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  /// By name and partition. Only the groups' thread uses the ConsumerGroup objects.
  std::map<std::pair<std::string, std::optional<std::int32_t>>, std::shared_ptr<ConsumerGroup>> groups_
      IOTCLOUD_GUARDED_BY(mutex_);
  config::ThreadRole on_thread_;
  std::vector<std::shared_ptr<ConsumerGroup>> leaving_ IOTCLOUD_GUARDED_BY(on_thread_);
  std::thread thread_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::brokers::kafka
