#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "iotcloud/brokers/rabbitmq/cluster.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/mutex.h>

namespace iotcloud::brokers::rabbitmq {

/// Removes queues that nobody needs any more, see Broker::remove_queue(). A thread asks the server again and again, as
/// long as a queue is in use and its time is not up. Waits go by the injected clock. Thread safe.
class QueueRemover {
 public:
  struct Unneeded {
    std::string queue;
    config::Clock::Instant until;  ///< when the remover gives the queue up
  };
  /// Asks a server once to remove each of these queues. \param answers gets for each one an empty text, or why the
  /// server keeps it. \throws LinkError if no server can be asked, or cannot be asked any more
  using Attempt = std::function<void(const std::vector<Unneeded>& queues, std::vector<std::string>& answers)>;

  /// \param clock outlives this object
  QueueRemover(Attempt attempt, const config::Clock& clock) : attempt_(std::move(attempt)), clock_(clock) {}
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
  void run();
  std::vector<Unneeded> try_all(std::vector<Unneeded> queues) IOTCLOUD_EXCLUDES(mutex_);

  const Attempt attempt_;
  const config::Clock& clock_;
  config::Mutex mutex_;
  config::ConditionVariable changed_;
  std::vector<Unneeded> queues_ IOTCLOUD_GUARDED_BY(mutex_);
  bool over_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  std::thread thread_ IOTCLOUD_GUARDED_BY(mutex_);  ///< since the first queue
};

/// An attempt on a connection of its own, to the first server of the cluster that answers. \param cluster outlives it
QueueRemover::Attempt attempt_at(const Cluster& cluster);

}  // namespace iotcloud::brokers::rabbitmq
