#pragma once

#include <chrono>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/rabbitmq/cluster.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::rabbitmq {

/// Removes queues that nobody needs any more, see Broker::remove_queue(). A thread does it, on a connection that is
/// open while there are such queues. Thread safe.
class QueueRemover {
 public:
  /// \param cluster outlives this object
  explicit QueueRemover(const Cluster& cluster) : cluster_(cluster) {}
  /// Waits until the server has taken all queues, or time is up.
  ~QueueRemover();
  QueueRemover(const QueueRemover&) = delete;
  QueueRemover& operator=(const QueueRemover&) = delete;

  void remove(std::string queue);

  /// How long a queue that has a reader or messages is tried.
  static constexpr std::chrono::seconds patience{2};
  /// Time between two attempts.
  static constexpr std::chrono::milliseconds pause{100};

 private:
  struct Unneeded {
    std::string queue;
    config::Clock::Instant until;  ///< when the remover gives the queue up
  };

  void run();
  std::vector<Unneeded> try_all(std::vector<Unneeded> queues) IOTCLOUD_EXCLUDES(mutex_);
  std::unique_ptr<AmqpLink> connect() const;

  const Cluster& cluster_;
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  std::vector<Unneeded> queues_ IOTCLOUD_GUARDED_BY(mutex_);
  bool over_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::thread thread_ IOTCLOUD_GUARDED_BY(mutex_);  ///< since the first queue
};

}  // namespace iotcloud::brokers::rabbitmq
