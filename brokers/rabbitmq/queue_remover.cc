#include "iotcloud/brokers/rabbitmq/queue_remover.h"

#include <iterator>
#include <memory>
#include <utility>

#include "iotcloud/brokers/rabbitmq/logger.h"

namespace iotcloud::brokers::rabbitmq {
namespace {

/// Connects to the first server that answers. \throws LinkError if none does.
std::unique_ptr<AmqpLink> connect_to_remove(const Cluster& cluster) {
  for (std::size_t server = 0; server + 1 < cluster.size(); ++server) {
    try {
      return cluster.connect(server, "removing queues", Login::reader);
    } catch (const LinkError& error) {
      logger.debug("{}: {}", cluster.name(server), error.what());
    }
  }
  return cluster.connect(cluster.size() - 1, "removing queues", Login::reader);
}

}  // namespace

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
  queues_.push_back({std::move(queue), clock_.now() + patience});
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
    changed_.wait_until(mutex_, clock_, clock_.now() + pause);
  }
}

/// Asks the server to remove each queue once. \return the queues that the server keeps for now, to be tried again
std::vector<QueueRemover::Unneeded> QueueRemover::try_all(std::vector<Unneeded> queues) {
  std::vector<std::string> answers;
  std::string trouble;
  try {
    attempt_(queues, answers);
  } catch (const LinkError& error) {
    trouble = error.what();
  }
  std::vector<Unneeded> refused;
  for (std::size_t i = 0; i < queues.size(); ++i) {
    if (i >= answers.size()) {
      logger.info("nobody needs the queue {} any more, but the server could not be asked to remove it: {}",
                  queues[i].queue, trouble);
    } else if (answers[i].empty()) {
      logger.debug("the queue {} is removed: nobody needs it any more", queues[i].queue);
    } else if (clock_.now() < queues[i].until) {
      refused.push_back(std::move(queues[i]));
    } else {
      logger.info("nobody needs the queue {} any more, but the server keeps it: {}", queues[i].queue, answers[i]);
    }
  }
  return refused;
}

QueueRemover::Attempt attempt_at(const Cluster& cluster) {
  return [&cluster](const std::vector<QueueRemover::Unneeded>& queues, std::vector<std::string>& answers) {
    const auto link = connect_to_remove(cluster);
    for (const auto& unneeded : queues) answers.push_back(link->remove_idle_queue(publish_channel, unneeded.queue));
    link->close(0);
  };
}

}  // namespace iotcloud::brokers::rabbitmq
