#include "iotcloud/brokers/rabbitmq/queue_remover.h"

#include <iterator>
#include <memory>
#include <utility>

#include "iotcloud/brokers/rabbitmq/logger.h"

namespace iotcloud::brokers::rabbitmq {

QueueRemover::~QueueRemover() {
  std::thread thread;
  {
    const config::MutexLock lock(mutex_);
    over_ = true;
    thread.swap(thread_);
    changed_.notify_all();
  }
  if (thread.joinable()) thread.join();
}

void QueueRemover::remove(std::string queue) {
  const config::MutexLock lock(mutex_);
  queues_.push_back({std::move(queue), config::system_clock().now() + patience});
  if (!thread_.joinable()) thread_ = std::thread([this] { run(); });
  changed_.notify_all();
}

void QueueRemover::run() {
  const config::MutexLock lock(mutex_);
  while (true) {
    while (queues_.empty() && !over_) changed_.wait(mutex_);
    if (queues_.empty()) return;
    std::vector<Unneeded> refused;
    {
      std::vector<Unneeded> queues = std::exchange(queues_, {});
      const config::Unlocked unlocked(mutex_);
      refused = try_all(std::move(queues));
    }
    if (refused.empty()) continue;
    std::move(refused.begin(), refused.end(), std::back_inserter(queues_));
    changed_.wait_for(mutex_, pause);
  }
}

/// Asks the server to remove each queue once. \return the queues that the server keeps for now, to be tried again
std::vector<QueueRemover::Unneeded> QueueRemover::try_all(std::vector<Unneeded> queues) {
  std::vector<Unneeded> refused;
  std::size_t asked = 0;
  try {
    const auto link = connect();
    for (auto& unneeded : queues) {
      const std::string why = link->remove_idle_queue(publish_channel, unneeded.queue);
      ++asked;
      if (why.empty()) {
        logger.debug("the queue {} is removed: nobody needs it any more", unneeded.queue);
      } else if (config::system_clock().now() < unneeded.until) {
        refused.push_back(std::move(unneeded));
      } else {
        logger.info("nobody needs the queue {} any more, but the server keeps it: {}", unneeded.queue, why);
      }
    }
    link->close(0);
  } catch (const LinkError& error) {
    for (std::size_t i = asked; i < queues.size(); ++i) {
      logger.info("nobody needs the queue {} any more, but the server could not be asked to remove it: {}",
                  queues[i].queue, error.what());
    }
  }
  return refused;
}

/// Connects to the first server that answers. \throws LinkError if none does.
std::unique_ptr<AmqpLink> QueueRemover::connect() const {
  for (std::size_t server = 0; server + 1 < cluster_.size(); ++server) {
    try {
      return cluster_.connect(server, "removing queues", Login::reader);
    } catch (const LinkError& error) {
      logger.debug("{}: {}", cluster_.name(server), error.what());
    }
  }
  return cluster_.connect(cluster_.size() - 1, "removing queues", Login::reader);
}

}  // namespace iotcloud::brokers::rabbitmq
