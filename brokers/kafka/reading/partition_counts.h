#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>

#include "iotcloud/brokers/client/backoff.h"
#include "iotcloud/brokers/kafka/client.h"
#include "iotcloud/brokers/kafka/renewal.h"
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::kafka {

/// Asks the servers again and again into how many partitions topics are split, on a thread and a connection of its own
/// that begin with the first topic. Thread safe.
class PartitionCounts {
 public:
  PartitionCounts(const KafkaOptions& options, const config::Clock& clock);
  ~PartitionCounts();
  PartitionCounts(const PartitionCounts&) = delete;
  PartitionCounts& operator=(const PartitionCounts&) = delete;

  /// \param told see Broker::watch_partitions(). \return a number for ignore()
  int follow(const std::string& topic, std::function<void(int)> told);
  /// Returns when the callback does not run any more; not to be called from it.
  void ignore(int follower);

 private:
  using Instant = config::Clock::Instant;
  /// A topic that is there is asked for this often, and one that is missing more often.
  static constexpr std::chrono::milliseconds ask_period{5000};
  struct Follower {
    std::string topic;
    std::function<void(int)> told;
    int count = 0;  ///< that it was told; 0: none
    Instant ask_at{};
    client::Backoff backoff{std::chrono::milliseconds(50), std::chrono::milliseconds(2000)};
  };

  void run();
  Instant ask_due(Instant now) IOTCLOUD_REQUIRES(mutex_);
  int ask(const std::string& topic);
  void tell(int number, int count) IOTCLOUD_REQUIRES(mutex_);

  const KafkaOptions& options_;
  const config::Clock& clock_;
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  bool closing_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  int last_ IOTCLOUD_GUARDED_BY(mutex_) = 0;
  int telling_ IOTCLOUD_GUARDED_BY(mutex_) = 0;  ///< the number of the follower whose callback runs; 0: none
  std::map<int, Follower> followers_ IOTCLOUD_GUARDED_BY(mutex_);
  config::ThreadRole on_thread_;
  Renewal renewal_ IOTCLOUD_GUARDED_BY(on_thread_);
  std::shared_ptr<KafkaClient> client_ IOTCLOUD_GUARDED_BY(on_thread_);
  std::thread thread_ IOTCLOUD_GUARDED_BY(mutex_);
};

}  // namespace iotcloud::brokers::kafka
